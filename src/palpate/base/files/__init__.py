"""Files from outside: what they may cost, how their bytes are read, and a process in which to read them.

Beneath every layer but `errors`: files are read through `read_bytes`, and by foreign parsers within
`confined`.
"""

from palpate.base.files.confined import confined
from palpate.base.files.opening import check_file, read_bytes

__all__ = ["check_file", "confined", "read_bytes"]

"""Everything that comes in from files, and what goes out as JSON: formats, checks, shipped rigs and models.

Files are read once at the start of the data's way and become frozen values. A file that is not usable is
an `InputError` with one line that names the file, the place, what is wrong and what is allowed.
"""

from palpate.config.contacts_file import ContactEntry, ContactsFile, GripEntry, Travel, load_contacts
from palpate.config.objects_file import ObjectModel, ObjectsFile, Polygon, Section, State, load_objects
from palpate.config.scene_file import Scene, load_scene

__all__ = [
    "ContactEntry",
    "ContactsFile",
    "GripEntry",
    "ObjectModel",
    "ObjectsFile",
    "Polygon",
    "Scene",
    "Section",
    "State",
    "Travel",
    "load_contacts",
    "load_objects",
    "load_scene",
]

"""Memory of an emulated servo: its control table byte by byte, with the checks that its firmware makes.

Which items there are comes from `dynamixel.control_table`. `servo_firmware` asks this memory whether an
access is allowed by the table itself; what depends on the servo's state it judges on its own.

Indirect Data stands for the address that its Indirect Address names, for reading and writing, one step deep:
an Indirect Address that names other Indirect Data gets that byte as it is stored.
"""

from collections.abc import Iterator, Mapping, Sequence
from struct import Struct

from palpate.drivers.dynamixel.control_table import Access, Area, TableItem
from palpate.drivers.dynamixel.packet import StatusErrorCode

_INDIRECT_ADDRESS = "Indirect Address "
_INDIRECT_DATA = "Indirect Data "
_UNSIGNED = {1: Struct("<B"), 2: Struct("<H"), 4: Struct("<I")}
_SIGNED = {1: Struct("<b"), 2: Struct("<h"), 4: Struct("<i")}


class Refused(Exception):
    """An instruction that the servo answers with an error number instead of carrying it out."""

    def __init__(self, code: StatusErrorCode) -> None:
        super().__init__(code.name)
        self.code = code


class ControlTable:
    """A servo's memory, byte addressed and little endian. `changes` grows with whatever is set."""

    def __init__(self, items: Sequence[TableItem]) -> None:
        self._items = {item.name: item for item in items}
        self._at = {item.address: item for item in items}
        self._end = max(item.address + item.size for item in items)
        self._defined = {
            address for item in items for address in range(item.address, item.address + item.size)
        }
        self._pointer_of = {
            item.address: self._items[_INDIRECT_ADDRESS + item.name.removeprefix(_INDIRECT_DATA)].address
            for item in items
            if item.name.startswith(_INDIRECT_DATA)
        }
        self._places = {
            item.name: (item.address, (_SIGNED if item.signed else _UNSIGNED)[item.size]) for item in items
        }
        self._wrapped = {
            item.name: (item.address, _UNSIGNED[item.size], (1 << 8 * item.size) - 1) for item in items
        }
        self._pointers = frozenset(self._pointer_of.values())
        self._shown: dict[tuple[int, int], list[int]] = {}  # addresses that stand for others, by range
        self._memory = bytearray(self._end)
        self.changes = 0
        for item in items:
            self.set(item.name, item.default)

    def __contains__(self, name: str) -> bool:
        return name in self._items

    def __iter__(self) -> Iterator[TableItem]:
        return iter(self._items.values())

    def item(self, name: str) -> TableItem:
        """The item of that e-Manual name."""
        return self._items[name]

    def get(self, name: str) -> int:
        """Value of an item by its e-Manual name."""
        start, form = self._places[name]
        value: int = form.unpack_from(self._memory, start)[0]
        return value

    def set(self, name: str, value: int) -> None:
        """Store a value as the firmware itself does: no access or range check, wrapped to the item's size."""
        self.changes += 1
        start, form, mask = self._wrapped[name]
        form.pack_into(self._memory, start, value & mask)
        if start in self._pointers:
            self._shown.clear()

    def show(self, measured: Mapping[str, int]) -> None:
        """`set` for what is measured: no reason to look at anything else again, `changes` stays."""
        memory, places = self._memory, self._wrapped
        for name, value in measured.items():
            start, form, mask = places[name]
            form.pack_into(memory, start, value & mask)

    def reset(self, name: str) -> None:
        """Put an item back to its default."""
        self.set(name, self._items[name].default)

    def reset_ram(self) -> None:
        """Put RAM back to its defaults, as a reboot does."""
        for item in self._items.values():
            if item.area is Area.RAM:
                self.set(item.name, item.default)

    def read(self, address: int, length: int) -> bytes:
        """Bytes of `length` addresses, through Indirect Address where they are Indirect Data.

        A range that begins or ends outside the table, or begins at an undefined address, is refused with
        Access Error. Undefined addresses within a range read as 0.
        """
        places = self._shown.get((address, length))
        if places is None:
            end = address + length
            if length == 0 or end > self._end or self._resolve_address(address) not in self._defined:
                raise Refused(StatusErrorCode.ACCESS_ERROR)
            if self._pointer_of.keys().isdisjoint(range(address, end)):
                return bytes(self._memory[address:end])
            places = self._shown[address, length] = [self._resolve_address(at) for at in range(address, end)]
        memory = self._memory
        return bytes([memory[at] for at in places])

    def parse_write(self, address: int, data: bytes) -> list[tuple[TableItem, int]]:
        """Split a write into items with their values and check access and range; changes nothing.

        Indirect Data become the items that they stand for, with those items' access and range. Refused with
        Access Error at a read-only or undefined address, Data Length Error if the data, or the Indirect
        Addresses beneath them, end within an item, Data Range Error if a value is outside the item's range.
        """
        writes: list[tuple[TableItem, int]] = []
        position = 0
        while position < len(data):
            meant = self._resolve_address(address + position)
            item = self._at.get(meant)
            if item is None or item.access is not Access.RW:
                raise Refused(StatusErrorCode.ACCESS_ERROR)
            raw = data[position : position + item.size]
            if len(raw) < item.size or any(
                self._resolve_address(address + position + k) != meant + k for k in range(1, item.size)
            ):
                raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
            value = int.from_bytes(raw, "little", signed=item.signed)
            if not item.low <= value <= item.high:
                raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
            writes.append((item, value))
            position += item.size
        if not writes:
            raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
        return writes

    def _resolve_address(self, address: int) -> int:
        """The address that is read or written when a controller names `address`."""
        pointer = self._pointer_of.get(address)
        if pointer is None:
            return address
        meant = self._memory[pointer] | self._memory[pointer + 1] << 8
        return meant if meant < self._end else address

"""Records: numpy structures with named, typed fields, for what compiled functions work on.

A record is declared as a class and used as a structure:

    class Port(Struct):
        credit: F64 = 0.0  # [J]
        waves: Annotated[NDArray[np.float64], Field("f8", 8)]

    ports = Port.array(8)  # for compiled functions: shape (8,)
    port = Port.new(credit=0.1)  # one record, for Python: port.credit

Compiled functions read and write the fields in place by attribute, `port.credit += energy`, and
take the class as the type of their argument. A call with an array of records costs 0.2 us an
argument, one with a single record 2 us, where each number of a tuple costs 0.05 us: so the loops
hand over arrays, and only tests and tools hand over single records.

A frozen dataclass of numbers, such as a config, becomes a record of the same fields by `to_struct`.
"""

import dataclasses
from typing import (
    Annotated,
    Any,
    ClassVar,
    Self,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

StructArray: TypeAlias = NDArray[np.void]
"""An array of records of one kind, shape (n,)."""


@dataclasses.dataclass(frozen=True, slots=True)
class Field:
    """How a field is stored: the dtype of an element, or the record class, how many, and filled.

    Several dimensions are a tuple, `Field("f8", (6, 8))`.
    """

    element: Any
    count: int | tuple[int, ...] = 1
    fill: float = 0.0

    @property
    def dtype(self) -> Any:
        """The dtype of the whole field."""
        element = self.element
        if isinstance(element, type) and issubclass(element, Struct):
            element = element.dtype
        if self.count == 1:
            return element
        return element, self.count if isinstance(self.count, tuple) else (self.count,)


F64: TypeAlias = Annotated[float, Field("f8")]
I64: TypeAlias = Annotated[int, Field("i8")]
U64: TypeAlias = Annotated[int, Field("u8")]
U32: TypeAlias = Annotated[int, Field("u4")]
Flag: TypeAlias = Annotated[bool, Field("?")]

_PYTHON_FIELDS = {float: Field("f8"), int: Field("i8"), bool: Field("?")}


class Struct:
    """Base of all record classes; see the module's text. Never instantiated as a Python object."""

    dtype: ClassVar[np.dtype[np.void]]
    _blank: ClassVar[StructArray]

    def __init_subclass__(cls) -> None:
        """Work out the structure and its defaults from the annotations."""
        fields = {name: _find_field(hint) for name, hint in _get_field_hints(cls).items()}
        cls.dtype = np.dtype([(name, field.dtype) for name, field in fields.items()], align=True)
        cls._blank = np.zeros(1, cls.dtype)
        for name, field in fields.items():
            if isinstance(field.element, type) and issubclass(field.element, Struct):
                cls._blank[name] = field.element._blank[0]
            else:
                cls._blank[name] = getattr(cls, name, field.fill)

    @classmethod
    def array(cls, count: int = 1) -> StructArray:
        """Return an array of so many records with their defaults, shape (count,)."""
        return np.repeat(cls._blank, count)

    @classmethod
    def new(cls, **values: Any) -> Self:
        """Return one record, with `values` in place of its defaults."""
        record = view_struct(cls.array())
        for name, value in values.items():
            setattr(record, name, value)
        return cast(Self, record)


def view_struct(records: StructArray, index: int = 0) -> Any:
    """Return a view of one record of an array, whose fields can be read and written."""
    return records.view(np.recarray)[index]


def as_bytes(records: StructArray) -> NDArray[np.uint8]:
    """Return the bytes of records, sharing their memory.

    Copied as bytes, `as_bytes(copy)[:] = as_bytes(records)`, they take a tenth of the time that
    numpy needs field by field.
    """
    return records.view(np.uint8)


def to_struct_array(config: object) -> StructArray:
    """Return an array of one record with the fields and values of a frozen dataclass.

    Nested dataclasses become nested records. A field that is no number, flag or dataclass is left
    out: no compiled function needs it.
    """
    return np.array([_collect_values(config)], dtype=build_struct_dtype(type(config)))


def to_struct(config: T) -> T:
    """Return `to_struct_array` as one record; typed as the dataclass, whose fields it has."""
    return cast(T, view_struct(to_struct_array(config)))


def build_struct_dtype(cls: type) -> np.dtype[np.void]:
    """Return the structure of a dataclass's numbers, flags and nested dataclasses."""
    hints = get_type_hints(cls)
    fields: list[Any] = []
    for item in dataclasses.fields(cls):
        hint = hints[item.name]
        if hint in _PYTHON_FIELDS:
            fields.append((item.name, _PYTHON_FIELDS[hint].dtype))
        elif dataclasses.is_dataclass(hint):
            fields.append((item.name, build_struct_dtype(cast(type, hint))))
    return np.dtype(fields, align=True)


def _collect_values(config: object) -> tuple[Any, ...]:
    names = build_struct_dtype(type(config)).names or ()
    values = (getattr(config, name) for name in names)
    return tuple(_collect_values(v) if dataclasses.is_dataclass(v) else v for v in values)


def _get_field_hints(cls: type) -> dict[str, Any]:
    hints = get_type_hints(cls, include_extras=True)
    return {name: hint for name, hint in hints.items() if name not in ("dtype", "_blank")}


def _find_field(hint: Any) -> Field:
    if isinstance(hint, type) and issubclass(hint, Struct):
        return Field(hint)
    return next(item for item in get_args(hint) if isinstance(item, Field))

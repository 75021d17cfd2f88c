"""Records: the same names and values in Python, in numpy and in compiled code."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import jit_compile
from estimator.structs import (
    F64,
    I64,
    U64,
    Field,
    Flag,
    Struct,
    to_struct,
    to_struct_array,
    view_struct,
)


class Inner(Struct):
    value: F64 = 0.5
    count: I64 = -1
    told: Flag = True


class Outer(Struct):
    many: Annotated[Sequence[Inner], Field(Inner, 3)]
    single: Inner
    numbers: Annotated[NDArray[np.float64], Field("f8", 4, fill=math.nan)]
    nonce: U64 = 0


@dataclass(frozen=True)
class Nested:
    gain: float = 2.0


@dataclass(frozen=True)
class Config:
    limit: float = 1.5
    rounds: int = 3
    on: bool = True
    name: str = "left out"
    nested: Nested = field(default_factory=Nested)


@jit_compile
def change(outer: Outer, index: int) -> float:
    outer.many[index].value += 1.0
    outer.single.count = 7
    outer.numbers[index] = 0.25
    return outer.many[index].value


@jit_compile
def scaled(config: Config, value: float) -> float:
    return config.limit * config.nested.gain * value if config.on else 0.0


def test_defaults_reach_every_level() -> None:
    record = Outer.new(nonce=2**63)
    assert record.nonce == 2**63
    assert np.isnan(record.numbers).all()
    assert [r.value for r in record.many] == [0.5] * 3
    assert record.single.count == -1
    assert bool(record.single.told)


def test_compiled_code_changes_the_very_record() -> None:
    records = Outer.array(2)
    record = view_struct(records, 1)
    assert change(record, 2) == 1.5
    assert records[1]["many"][2]["value"] == 1.5
    assert record.single.count == 7
    assert record.numbers[2] == 0.25
    assert np.isnan(view_struct(records).numbers).all()  # the other one is as it was


def test_a_config_becomes_a_record_of_its_numbers() -> None:
    assert to_struct_array(Config()).dtype.names == ("limit", "rounds", "on", "nested")
    assert scaled(to_struct(Config(limit=3.0)), 2.0) == 12.0
    assert scaled(to_struct(Config(on=False)), 2.0) == 0.0

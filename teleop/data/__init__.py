"""Measured data: tables in and out, and the model files made from them."""

from teleop.data.measured_table import (
    Columns,
    MeasuredTable,
    read_runs,
    read_table,
    read_tables,
    write_table,
)

__all__ = ["Columns", "MeasuredTable", "read_runs", "read_table", "read_tables", "write_table"]

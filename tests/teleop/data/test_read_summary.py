"""How a table was read is said on one line."""

import numpy as np

from teleop.data.mapping_file import parse_column_options
from teleop.data.measured_table import read_table
from teleop.data.read_summary import ReadSummary, format_read_summaries, format_read_summary

TIME = np.delete(np.arange(50) * 20.0, [30, 31])  # [ms]
CELLS = [f"{t:.0f};{5 + np.sin(t / 300):.4f};{1 + np.sin(t / 300):.5f}" for t in TIME]
CELLS[4], CELLS[7] = "80;OVLD;1,0", "140;5.0;"
TEXT = "\n".join(["Bench;3", "t;F [kgf];q_mm", *CELLS]).replace(".", ",")


def test_columns_units_rate_and_what_is_missing_are_said(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text(TEXT)
    options = ["time=t[ms]", "proximal_tension=F [kgf]", "proximal_displacement=q_mm"]
    table = read_table(path, parse_column_options(options).names, True, diagnosed=True)
    reading = ReadSummary.from_table(table).to_json()
    assert (reading["samples"], reading["dropped"], reading["gaps"]) == (46, 2, 3)
    assert reading["channels"]["proximal_displacement"]["factor"] == 1e-3
    assert format_read_summary(reading) == (
        "46 samples, 0.98 s, 50 Hz; 2 rows left out; 3 gaps, the longest 0.06 s; time from t [ms]; "
        "proximal_tension from F [kgf] [kgf]; proximal_displacement from q_mm [mm]; semicolons "
        "between columns; decimal commas; names in line 2; column 'F [kgf]' has 1 OVLD (an "
        "overload: out of the range)"
    )
    plain = read_table(path, parse_column_options(options).names, diagnosed=True)
    assert "1 proximal_displacement missing" in format_read_summary(
        ReadSummary.from_table(plain).to_json()
    )
    assert format_read_summaries([reading] * 9).endswith("\nread as: 3 files more, in the report")

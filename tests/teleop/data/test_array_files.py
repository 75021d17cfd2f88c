"""Spreadsheets and files of arrays give the same table as text does."""

import json
import zipfile

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather
from scipy import io

from teleop.data import Columns, read_table
from teleop.data.mapping_file import TableMapping
from teleop.errors import UsageError

TIME = np.arange(40) / 20
TENSION = 6.0 - 5.0 * np.cos(3.0 * TIME)
TRAVEL = 0.01 * TENSION
COLUMNS = {
    "Time [ms]": 1e3 * TIME,
    "proximal_tension_N": TENSION,
    "proximal_displacement_m": TRAVEL,
}
SCHEMA = "http://schemas.openxmlformats.org"


def write_xlsx(path, **sheets):
    """Write sheets of rows, as far as a reader needs them."""
    numbers = range(1, len(sheets) + 1)
    kind = f"{SCHEMA}/officeDocument/2006/relationships"
    link = f'<Relationship Id="r{{0}}" Type="{kind}/{{1}}" Target="{{2}}"/>'
    links = f'<Relationships xmlns="{SCHEMA}/package/2006/relationships">{{}}</Relationships>'
    main = f'xmlns="{SCHEMA}/spreadsheetml/2006/main"'
    names = "".join(
        f'<sheet name="{s}" sheetId="{n}" r:id="r{n}"/>' for n, s in enumerate(sheets, 1)
    )
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{SCHEMA}/package/2006/content-types"/>',
        "_rels/.rels": links.format(link.format(1, "officeDocument", "xl/workbook.xml")),
        "xl/workbook.xml": f'<workbook {main} xmlns:r="{kind}"><sheets>{names}</sheets></workbook>',
        "xl/_rels/workbook.xml.rels": links.format(
            "".join(link.format(n, "worksheet", f"s{n}.xml") for n in numbers)
        ),
    }
    for n, rows in zip(numbers, sheets.values(), strict=True):
        lines = "".join(f"<row>{''.join(map(_format_cell, row))}</row>" for row in rows)
        sheet = f"<worksheet {main}><sheetData>{lines}</sheetData></worksheet>"
        parts[f"xl/s{n}.xml"] = sheet
    with zipfile.ZipFile(path, "w") as file:
        for name, text in parts.items():
            file.writestr(name, text)


def _format_cell(value):
    if isinstance(value, str):
        return f'<c t="inlineStr"><is><t>{value}</t></is></c>'
    return f"<c><v>{value!r}</v></c>"


def check(found):
    np.testing.assert_allclose(found.time, TIME, atol=1e-12)
    np.testing.assert_allclose(found.proximal_tension, TENSION)
    np.testing.assert_allclose(found.proximal_displacement, TRAVEL)


def test_a_sheet_with_lines_above_and_units_below_its_names(tmp_path):
    pytest.importorskip("python_calamine")
    names = ["time", "proximal_tension", "proximal_displacement"]
    values = [list(map(float, row)) for row in zip(*COLUMNS.values(), strict=True)]
    rows = [["Bench", "3", ""], names, ["ms", "N", "m"], *values]
    write_xlsx(tmp_path / "x.xlsx", Data=rows)
    check(read_table(tmp_path / "x.xlsx"))
    rows[7][1] = "broken"
    write_xlsx(tmp_path / "x.xlsx", Data=rows)
    with pytest.raises(UsageError, match="row 8: 'broken' is not a number"):
        read_table(tmp_path / "x.xlsx")


def test_of_several_sheets_one_is_named(tmp_path):
    pytest.importorskip("python_calamine")
    rows = [list(COLUMNS), *(list(map(float, r)) for r in zip(*COLUMNS.values(), strict=True))]
    write_xlsx(tmp_path / "x.xlsx", Monday=rows, Tuesday=rows)
    with pytest.raises(UsageError, match="has 'Monday', 'Tuesday'; name one: `sheet"):
        read_table(tmp_path / "x.xlsx")
    check(read_table(tmp_path / "x.xlsx", mapping=TableMapping(sheet="Tuesday")))


def test_variables_of_matlab_and_of_its_structs(tmp_path, capsys):
    names = ["time_ms", "proximal_tension_N", "proximal_displacement_m"]
    variables = dict(zip(names, COLUMNS.values(), strict=True)) | {"gain": np.arange(3.0)}
    io.savemat(tmp_path / "x.mat", variables)
    check(read_table(tmp_path / "x.mat"))
    assert "gain left out, not of 40 values" in capsys.readouterr().err
    io.savemat(tmp_path / "x.mat", {"run": {"t": TIME, "T": TENSION, "q": TRAVEL}})
    mapped = {"time": "run.t", "proximal_tension": "run.T", "proximal_displacement": "run.q"}
    check(read_table(tmp_path / "x.mat", Columns(**mapped)))


def test_arrays_of_numpy_are_read_and_objects_are_not(tmp_path):
    np.savez(tmp_path / "x.npz", **COLUMNS)
    check(read_table(tmp_path / "x.npz"))
    np.savez(tmp_path / "x.npz", **COLUMNS, note=np.array([{"a": 1}], dtype=object))
    with pytest.raises(UsageError, match="cannot be read"):
        read_table(tmp_path / "x.npz")


def test_one_array_of_numpy_has_numbered_columns(tmp_path):
    np.save(tmp_path / "x.npy", np.column_stack([*COLUMNS.values()]))
    mapped = {"time": "column:1[ms]", "proximal_tension": "column:2"}
    check(read_table(tmp_path / "x.npy", Columns(**mapped, proximal_displacement="column:3[m]")))
    np.save(tmp_path / "x.npy", np.array([{"a": 1}], dtype=object))
    with pytest.raises(UsageError, match="cannot be read"):
        read_table(tmp_path / "x.npy")


@pytest.mark.parametrize("form", ["samples", "lines", "columns", "nested"])
def test_json_of_samples_or_of_columns(tmp_path, form):
    samples = [dict(zip(COLUMNS, row, strict=True)) for row in zip(*COLUMNS.values(), strict=True)]
    text = {
        "samples": json.dumps(samples),
        "lines": "\n".join(map(json.dumps, samples)) + "\n",
        "columns": json.dumps({name: [*values] for name, values in COLUMNS.items()}),
        "nested": json.dumps([{"rig": sample, "name": "a"} for sample in samples]),
    }
    (tmp_path / "x.json").write_text(text[form])
    names = [f"rig.{name}" * (form == "nested") or name for name in COLUMNS]
    check(read_table(tmp_path / "x.json", Columns(*names)))


def test_null_in_json_is_a_missing_value(tmp_path):
    samples = [{"time_s": k, "proximal_tension_N": None if k == 4 else 1.0} for k in range(9)]
    (tmp_path / "x.jsonl").write_text("\n".join(map(json.dumps, samples)))
    with pytest.raises(UsageError, match="1 of 9 values are missing or not finite, the first in r"):
        read_table(tmp_path / "x.jsonl", Columns("time_s[ms]"))


def test_feather(tmp_path):
    feather.write_feather(pa.table(COLUMNS), tmp_path / "x.feather")
    check(read_table(tmp_path / "x.feather"))


def test_datasets_of_hdf5_with_their_units(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["time"] = 1e3 * TIME
        file["time"].attrs["units"] = "ms"
        file["proximal_tension_N"], file["proximal_displacement_m"] = TENSION, TRAVEL
    check(read_table(tmp_path / "x.h5"))


@pytest.mark.parametrize("suffix", ["xlsx", "mat", "npz", "npy", "json", "feather", "h5"])
def test_what_is_not_such_a_file_is_refused_in_one_line(tmp_path, suffix):
    for module in ("python_calamine", "h5py"):
        pytest.importorskip(module)
    (tmp_path / f"x.{suffix}").write_bytes(b"time_s,proximal_tension_N\n0,1\n" * 9)
    with pytest.raises(UsageError) as caught:
        read_table(tmp_path / f"x.{suffix}")
    assert "\n" not in str(caught.value)

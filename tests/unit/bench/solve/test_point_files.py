"""Point files as programs and spreadsheets write them: the view is the same, or the mistake is named."""

import numpy as np
import pytest

from bench.base.errors import BenchError
from bench.solve.point_files import read_point_file

X, Y = (axis.ravel() for axis in np.meshgrid(np.arange(5) * 8.0, np.arange(4) * 8.0))
ROWS = np.column_stack([100.5 + 30.1 * X + 0.3 * Y, 80.25 + 29.9 * Y - 0.2 * X, X, Y, np.arange(20)])


def text(rows, template="{0},{1},{2},{3},{4}", header=""):
    lines = [template.format(*(f"{value:.4f}" for value in row[:4]), int(row[4])) for row in rows]
    return "\n".join([header, *lines] if header else lines)


def read(tmp_path, content, **options):
    (tmp_path / "a.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_point_file(tmp_path / "a.csv", image_size=(1400, 900), **options)


COMMAS = text(ROWS, "{0};{1};{2};{3};{4}").replace(".", ",")
SAME = {
    "a header": text(ROWS, header="x,y,X,Y,id"),
    "a header with units": text(ROWS, header="x_px, y_px, X [mm], Y [mm], id"),
    "a header in another order": text(ROWS, "{4},{2},{3},{0},{1}", "id,X,Y,x,y"),
    "an index and Z = 0, as pandas writes them": text(ROWS, "7,{0},{1},{2},{3},0.0,{4}", ",x,y,X,Y,Z,id"),
    "decimal commas, semicolons": COMMAS,
    "decimal commas, tabs": COMMAS.replace(";", "\t"),
    "quoted": text(ROWS, '"{0}","{1}","{2}","{3}","{4}"', '"x","y","X","Y","id"'),
    "quoted decimal commas": text(ROWS, '"{0}";"{1}";"{2}";"{3}";"{4}"').replace(".", ",").replace(";", ","),
    "a line for a spreadsheet, and rows without content": f"sep=;\n{COMMAS}\n;;;;\n;;;;\n",
    "ID": text(ROWS, header="x,y,X,Y,ID"),
    "comments of capitals": text(ROWS, header="#STARS, of run 3\n#DATE;2026\n#X,Y,x,y,id\n#NVIDIA,1"),
    "a comma at the end": text(ROWS, "{0},{1},{2},{3},{4},"),
    "UTF-16 of a spreadsheet": text(ROWS, "{0}\t{1}\t{2}\t{3}\t{4}").encode("utf-16"),
}


@pytest.mark.parametrize("content", SAME.values(), ids=SAME)
def test_points_of_spreadsheets_are_read(tmp_path, content):
    view = read(tmp_path, content)
    np.testing.assert_allclose(view.points_px, ROWS[:, :2] - 0.5, atol=1e-4)
    np.testing.assert_array_equal(view.target_mm, ROWS[:, 2:4])
    assert view.ids.tolist() == list(range(20))


def test_pixels_of_matlab_are_counted_from_1(tmp_path):
    np.testing.assert_allclose(
        read(tmp_path, text(ROWS), origin="matlab").points_px, ROWS[:, :2] - 1.0, atol=1e-4
    )


WRONG = {
    "shares of the image": (text(ROWS / [1400, 900, 1, 1, 1]), "within 1.5 px"),
    "the target before the image": (text(ROWS[:, [2, 3, 0, 1, 4]]), "target seems to stand before the image"),
    "a header without ids": (text(ROWS, "{0},{1},{2},{3}", "x,y,X,Y"), "no column 'id'"),
    "a header of small letters": (text(ROWS, header="x,y,x,y,id"), "2 columns 'x'"),
    "a target in m by its header": (text(ROWS, header="x,y,X_m,Y_m,id"), "no column 'X'"),
    "a note of a person": ("taken on Monday\n", "no list of points"),
    "a target that is not flat": (text(ROWS, "{0},{1},{2},{3},5,{4}", "x,y,X,Y,Z,id"), "plane Z = 0"),
    "a cell that was not computed": (f"{text(ROWS)}\n#DIV/0!,2,3,4,25\n", "Not a number"),
    "a cell that was not computed in German": (f"{text(ROWS)}\n#ZAHL!;2;3;4;25\n", "Not a number"),
    "a cell of an unknown name": (f"{text(ROWS)}\n#NAME?\t2\t3\t4\t25\n", "Not a number"),
    "umlauts of a spreadsheet": (
        text(ROWS, header="x,y,X,Y,id,H\u00f6he").encode("cp1252"),
        "not UTF-8 text",
    ),
    "a spreadsheet's own file": (
        b"PK\x03\x04" + bytes(26) + b"xl/workbook.xml",
        "The file is a document of an office program",
    ),
    "a column too many": (text(ROWS, "{0},{1},{2},{3},0,{4}"), "6 columns instead of 5"),
    "points and commas as decimal marks": ("1.000,5;2,5;3,5;4,5;6\n", "8 columns|9 columns"),
}


@pytest.mark.parametrize(("content", "why"), WRONG.values(), ids=WRONG)
def test_other_quantities_are_refused(tmp_path, content, why):
    with pytest.raises(BenchError, match=why) as error:
        read(tmp_path, content)
    assert error.value.remedy

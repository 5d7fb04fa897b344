"""Point files as programs and spreadsheets write them: the view is the same, or the mistake is named."""

import numpy as np
import pytest

from bench.base.errors import BenchError, StorageError
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
    "quoted decimal commas": text(ROWS, '"{0}";"{1}";"{2}";"{3}";"{4}"').replace(".", ",").replace(";", ","),
    "a line for a spreadsheet, and rows without content": f"sep=;\n{COMMAS}\n;;;;\n;;;;\n",
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


@pytest.mark.parametrize(("origin", "off"), [("corner", -0.5), ("matlab", -1.0), ("centre", 0.0)])
def test_pixels_are_counted_from_where_the_program_counts_them(tmp_path, origin, off):
    view = read(tmp_path, text(ROWS), origin=origin)
    np.testing.assert_allclose(view.points_px, ROWS[:, :2] + off, atol=1e-4)


def test_a_view_has_the_name_of_its_file_and_without_a_stated_size_that_of_its_points(tmp_path):
    assert (read(tmp_path, text(ROWS)).name, read(tmp_path, text(ROWS)).image_size) == ("a", (1400, 900))
    (tmp_path / "few.txt").write_text("\ufeff10.5 20.5 4.0 8.0 7\n# a remark\n\n30.5, 40.5, 12.0, 16.0, 9\n")
    assert read_point_file(tmp_path / "few.txt", image_size=None, origin="centre").image_size == (32, 42)
    assert len(read_point_file(tmp_path / "few.txt", image_size=(30, 40))) == 2
    with pytest.raises(BenchError, match=r"1 of 2 points .* 48 x 32 px; .*30\.5, 40\.5"):
        read_point_file(tmp_path / "few.txt", image_size=(48, 32))  # the sides in the other order
    with pytest.raises(StorageError, match="cannot be read"):
        read_point_file(tmp_path / "none.csv", image_size=(1400, 900))


WRONG = {
    "shares of the image": (text(ROWS / [1400, 900, 1, 1, 1]), "within 1.5 px"),
    "the target before the image": (text(ROWS[:, [2, 3, 0, 1, 4]]), "target seems to stand before the image"),
    "a header without ids": (text(ROWS, "{0},{1},{2},{3}", "x,y,X,Y"), r"a\.csv:1: .*no column 'id'"),
    "a note of a person": ("taken on Monday\n", "no list of points"),
    "a target that is not flat": (text(ROWS, "{0},{1},{2},{3},5,{4}", "x,y,X,Y,Z,id"), "plane Z = 0"),
    "a cell that was not computed": (f"{text(ROWS)}\n#DIV/0!,2,3,4,25\n", "Not a number"),
    "umlauts of a spreadsheet": (text(ROWS, header="x,y,H\u00f6he").encode("cp1252"), "not UTF-8 text"),
    "a spreadsheet's own file": (b"PK\x03\x04" + bytes(26) + b"xl/workbook.xml", "an office program"),
    "a column too few": ("1 2 3 4 5\n1 2 3\n", r"a\.csv:2: .* 3 columns instead of 5"),
    "not finite": ("1 2 nan 4 5\n", r"a\.csv:1: .*not finite"),
    "half a number as id": ("1 2 3 4 5.5\n", r"a\.csv:1: .*integer"),
    "an id twice": ("1 2 3 4 5\n6 7 8 9 5\n", "a point twice"),
    "no points": ("\n# nothing\n", "has no points"),
    "a point outside": ("5 5 3 4 1\n-1.5 2 3 4 5\n", r"1 of 2 points are outside .* at \(-1\.5, 2\)"),
    "a column too many": (text(ROWS, "{0},{1},{2},{3},0,{4}"), "6 columns instead of 5"),
    "points and commas as decimal marks": ("1.000,5;2,5;3,5;4,5;6\n", "8 columns|9 columns"),
}


@pytest.mark.parametrize(("content", "why"), WRONG.values(), ids=WRONG)
def test_other_quantities_are_refused(tmp_path, content, why):
    with pytest.raises(BenchError, match=why) as error:
        read(tmp_path, content)
    assert error.value.remedy

"""Docstrings of the API leave nothing out; docstrings elsewhere have no form to fill in."""

import documented_api as api


def gaps(source):
    (entry,) = api.documented(source)
    return list(entry.gaps())


def test_the_api_leaves_nothing_out():
    names, _ = api.split_by_api()
    complete = [entry for entry in names if api.must_be_complete(entry)]
    assert len(complete) > 60
    assert [f"{entry.place}: {entry.name}: {gap}" for entry in complete for gap in entry.gaps()] == []


def test_every_name_of_calib_is_found_with_its_docstring():
    names, _ = api.split_by_api()
    offered = {name for names_of_file in api.calib_api().values() for name in names_of_file.split()}
    assert offered <= {entry.name for entry in names if entry.docstring}


def test_only_the_api_has_sections():
    _, inner = api.split_by_api()
    assert [f"{entry.place}: {entry.name}" for entry in inner if entry.has_sections()] == []


def test_the_check_sees_what_is_left_out():
    source = '''
def fit(points: Array, weights: Array | None, /, *, loss: str) -> Array:
    """Fit.

    Parameters
    ----------
    points
        Image points, px.
    loss
        Name of the loss.
    """
    raise ValueError("no")
'''
    assert gaps(source) == [
        "parameter points has no shape",
        "parameter weights is not described",
        "no Returns section",
        "ValueError is raised and not listed",
    ]

"""Docstrings of the API leave nothing out; docstrings elsewhere have no form to fill in."""

import documented_api as api


def gaps(source):
    (one,) = api.documented(source)
    return list(one.gaps())


def test_the_api_leaves_nothing_out():
    names, _ = api.split_by_api()
    complete = [one for one in names if api.must_be_complete(one)]
    assert len(complete) > 60
    assert [f"{one.place}: {one.name}: {gap}" for one in complete for gap in one.gaps()] == []


def test_every_name_of_calib_is_found_with_its_docstring():
    names, _ = api.split_by_api()
    offered = {name for names_of_file in api.calib_api().values() for name in names_of_file.split()}
    assert offered <= {one.name for one in names if one.docstring}


def test_only_the_api_has_sections():
    _, inner = api.split_by_api()
    assert [f"{one.place}: {one.name}" for one in inner if one.has_sections()] == []


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

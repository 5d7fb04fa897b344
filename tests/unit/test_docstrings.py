"""Docstrings of the API leave nothing out; docstrings elsewhere have no form to fill in."""

import documented_api as api


def gaps(source):
    (documented,) = api.documented(source)
    return list(documented.gaps())


def test_the_api_leaves_nothing_out():
    names, _ = api.split_by_api()
    complete = [documented for documented in names if api.must_be_complete(documented)]
    assert len(complete) > 60
    assert [
        f"{documented.place}: {documented.name}: {gap}"
        for documented in complete
        for gap in documented.gaps()
    ] == []


def test_every_name_of_calib_is_found_with_its_docstring():
    names, _ = api.split_by_api()
    offered = {name for names_of_file in api.calib_api().values() for name in names_of_file.split()}
    assert offered <= {documented.name for documented in names if documented.docstring}


def test_only_the_api_has_sections():
    _, inner = api.split_by_api()
    assert [
        f"{documented.place}: {documented.name}" for documented in inner if documented.has_sections()
    ] == []


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

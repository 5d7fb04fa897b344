"""A page of the list is told what changed, and adds up to the list as it is, however often it is told."""

from hypothesis import given
from hypothesis import strategies as st

from bench.extras.pages.panel.list_changes import ListChanges


def content(runs, faults=()):
    rows = [{"key": key, "accepted": accepted} for key, accepted in runs.items()]
    return {"root": "/r", "exists": True, "unread": 0, "runs": rows, "batches": [], "faults": list(faults)}


class Page:
    """Does as list.js: takes messages, and knows the rows."""

    def __init__(self):
        self.version, self.rows = 0, {}

    def take(self, message):
        if message["reset"]:
            self.rows.clear()
        for key in message["gone"]:
            self.rows.pop(key, None)
        self.rows.update({row["key"]: row for row in message["runs"]})
        self.version = message["version"]


def test_a_list_that_is_the_same_is_no_new_version():
    changes = ListChanges()
    changes.take(content({"a": 1}))
    begun = changes.version
    changes.take(content({"a": 1}))
    assert changes.version == begun
    changes.take(content({"a": 1}, faults=["b: no permission"]))
    assert changes.version == begun + 1


@given(
    st.lists(st.dictionaries(st.sampled_from("abcd"), st.integers(0, 3)), max_size=8),
    st.lists(st.booleans(), min_size=8, max_size=8),
)
def test_a_page_that_is_told_now_and_then_has_the_list(lists, told_now):
    changes, page = ListChanges(), Page()
    for runs, tell in zip(lists, told_now, strict=False):
        changes.take(content(runs))
        if tell:
            page.take(changes.since(page.version))
            assert {key: row["accepted"] for key, row in page.rows.items()} == runs

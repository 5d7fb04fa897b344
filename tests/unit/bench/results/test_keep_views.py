"""A run keeps its own views, so that `calibrate` need not find its stars again."""

from solved_run import write_solved_run

from bench.plan.job import Job
from bench.records.history import replay
from bench.records.journal import read_journal
from bench.results.offline import with_kept_views
from bench.results.offline_options import OfflineOptions
from bench.results.result import keep_views_of_run
from bench.results.view_sources import view_sources
from bench.views.kept_views import KeptViews, pack_view
from bench.views.measure import Measurement
from bench.views.views_file import read_views


def keep_views(folder):
    """Keep the views of a run, as its end does; return them."""
    job = Job.from_run_folder(folder)
    history = replay(read_journal(folder / "journal.jsonl")[0])
    views = [stored.view for stored in read_views(folder / "views.h5")]
    measured = {
        index: Measurement(view, None, {})
        for index, view in zip(sorted(history.accepted()), views, strict=True)
    }
    assert keep_views_of_run(job, history, measured) == len(views) == 4
    return views


def test_a_run_keeps_its_views(tmp_path):
    folder = write_solved_run(tmp_path)
    views = keep_views(folder)
    kept = KeptViews.of_bench()
    read = [with_kept_views(source, kept).read() for source in view_sources(folder, OfflineOptions())]
    assert (kept.used, kept.found) == (4, 0)
    assert [pack_view(view, "0") for view in read] == [pack_view(view, "0") for view in views]

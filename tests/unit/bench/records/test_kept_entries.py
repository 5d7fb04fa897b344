"""Entries that somebody has replaced by something else."""

from bench.views.kept_views import KeptEntries

KEY = "ab" * 32


def test_an_entry_larger_than_any_is_not_read(tmp_path):
    kept = KeptEntries(tmp_path / "kept", 1 << 20)
    kept.write_entry(KEY, b"content")
    assert kept.read_entry(KEY) == b"content"
    (path,) = (tmp_path / "kept").rglob("*.entry")
    with path.open("r+b") as file:
        file.truncate(10 << 30)
    assert kept.read_entry(KEY) is None
    assert not path.exists()
    (remark,) = kept.remarks
    assert "a kept entry is broken (it is larger than any entry)" in remark

"""The command line: help of every command, examples, and messages about invalid arguments."""

import json
import os
import re
import sqlite3
from pathlib import Path

import pytest
from calling import out_of, refusal
from command_words import CORE, check_help, check_words, commands, examples
from journals import MadeRun
from running import python

from bench.base.errors import StorageError
from bench.commands.cli import cli
from bench.commands.output import print_error

pytestmark = pytest.mark.usefixtures("here")
RUN_COMMANDS = [
    ("resume",),
    ("resume", "--dry-run"),
    ("status",),
    *(("tell", word) for word in ("hold", "skip", "yes")),
]


@pytest.mark.parametrize("words", [("calibrate", "raw\udcff/p.raw"), ("run", "x", "--operator", "J\udce9r")])
def test_a_name_that_results_could_not_state_is_refused_before_the_work(capsys, words):
    assert "UTF-8" in refusal(capsys, *words, status=2)


INTERRUPTED = """
import sys
class Interrupted:
    def find_spec(self, name, *_):
        if name == "click":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupted())
"""
ROOT = Path(__file__).parents[4]


COMMANDS = dict(commands(CORE))


@pytest.mark.parametrize("words", sorted(COMMANDS))
def test_help_of_a_command_has_a_purpose_an_example_and_its_statuses(say, words):
    status, text, _ = say(*words.split(), "--help")
    assert status == 0
    check_help(words, COMMANDS[words], text)


def test_the_list_of_commands_is_complete_and_not_truncated(say):
    listed = say("--help")[1]
    assert "..." not in listed.partition("A run:")[2]
    assert [name for name in cli.commands if f"\n  {name} " not in listed] == []


@pytest.mark.parametrize("line", examples(COMMANDS))
def test_an_example_uses_existing_arguments_and_options(line):
    assert check_words(line) == []


IN_PLACE_OF_A_RUN = {
    "nowhere": ["nowhere: There is no such run folder"],
    "runs": ["not a run folder", "runs/cam7"],
    "night": ["starbench batch QUEUE.yaml --output night"],
}


@pytest.mark.parametrize(
    ("words", "folder"),
    [
        (words, folder)
        for folder in IN_PLACE_OF_A_RUN
        for words in [*RUN_COMMANDS, ("verify",)]
        if (words, folder) != (("status",), "night")  # a batch has a status
    ],
)
def test_what_stands_in_place_of_a_run_is_an_invalid_argument(say, words, folder, tmp_path):
    for run in ("runs/cam7", "night", "night/runs/cam7-001"):
        (tmp_path / run).mkdir(parents=True)
        (tmp_path / run / "journal.jsonl").write_text("")
    (tmp_path / "night" / "queue.yaml").write_text("")
    status, _, message = say(words[0], folder, *words[1:])
    assert status == 2
    assert all(fact in message for fact in IN_PLACE_OF_A_RUN[folder])


@pytest.mark.parametrize("output", ["file", "file/inside"])
@pytest.mark.parametrize(
    "words", [("run", "three_pose", "-s", "simulated"), ("rehearse", "queue.yaml")], ids=" ".join
)
def test_an_output_that_is_a_file_is_refused(say, tmp_path, words, output):
    (tmp_path / "file").write_text("")
    (tmp_path / "queue.yaml").write_text("")
    status, _, message = say(*words, "--output", output)
    assert status == 2
    assert "is a file, not a folder" in message
    assert "--output" in message


@pytest.mark.parametrize("words", ["run three_pose -s simulated -o", "calibrate . --each -o", "station new"])
def test_no_output_is_written_into_a_sealed_folder(say, tmp_path, words):
    """A link leads into it, too. Root may write there, and FAT has no modes."""
    (tmp_path / "run/captures").mkdir(parents=True)
    (tmp_path / "run/SHA256SUMS.sig").touch()
    (tmp_path / "link").symlink_to("run/captures")
    status, _, message = say(*words.split(), "link/new.svg")
    assert (status, list((tmp_path / "run/captures").iterdir())) == (2, [])
    assert "run is sealed" in message


@pytest.mark.parametrize(
    "words",
    [("passport", "show", "source", "--seal"), ("passport", "make", "source", "-o"), ("station", "new")],
    ids=" ".join,
)
def test_a_new_file_that_cannot_be_created_is_refused_before_any_work(say, tmp_path, words):
    (tmp_path / "source").write_text("")
    taken = tmp_path / "taken.npz"
    taken.write_text("as it was")
    for path, fact in (("missing/new.npz", "no folder missing"), (taken, "already")):
        status, out, message = say(*words, path)
        assert (status, out, fact in message) == (2, "", True)
    assert taken.read_text() == "as it was"


@pytest.mark.parametrize(
    "words",
    [
        ("calibrate",), ("passport", "show"), ("passport", "make", "-o", "new.json"), ("batch", "-o", "out"), ("runs",),
        ("verify", ".", "--allowed-signers"), ("calibrate", ".", "--passport"), ("calibrate", ".", "--station"),
        ("simulate", "--station"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_missing_path_is_named_and_is_an_invalid_argument(say, words):
    status, _, message = say(*words, "nowhere")
    assert status == 2
    assert "nowhere: " in message
    assert "no such" in message


@pytest.mark.parametrize(
    "words", [("runs",), ("panel",), ("status",), ("calibrate", ".", "-o")], ids=" ".join
)
def test_an_empty_path_is_not_the_current_folder(say, words):
    """As of a variable that a script has not set."""
    status, out, message = say(*words, "")
    assert (status, out) == (2, "")
    assert "path is empty" in message


@pytest.mark.parametrize(
    "words", [("run", "three_pose"), ("status",), ("calibrate", "--origin", "none", ".")]
)
def test_with_json_an_invalid_argument_is_an_object_too(say, words):
    status, out, message = say(*words, "--json")
    assert status == 2
    assert json.loads(out)["error"]["message"] in message.replace("Error: ", "")


def test_characters_that_a_stream_cannot_show_are_replaced():
    program = "from bench.base.encoding import replace_unencodable as s; import sys; s(sys.stdout);"
    program += "print('3345.3 \u00b1 1.2, \u22120.9, \u674e')"
    ended = python("-c", program, cwd=ROOT, PYTHONIOENCODING="ascii")
    assert ended.stdout == "3345.3 +/- 1.2, -0.9, ?\n"


def test_ctrl_c_while_the_program_loads_prints_one_word(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTED)
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    ended = python("-m", "bench", "--help", status=130, PYTHONPATH=path)
    assert (ended.stdout, ended.stderr) == ("", "Stopped.\n")


@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_a_batch_is_refused_on_systems_other_than_linux(say, monkeypatch, tmp_path, system):
    (tmp_path / "queue.yaml").write_text("")
    monkeypatch.setattr("sys.platform", system)
    status, _, message = say("batch", "queue.yaml", "-o", "out")
    assert status == 2
    assert "only on Linux" in message
    assert "starbench run" in message
    assert not (tmp_path / "out").exists()


def test_files_of_the_bench_that_cannot_be_used_are_named(capsys, tmp_path):
    error = sqlite3.OperationalError("database or disk is full")
    assert print_error(error, []) == 1
    errors = capsys.readouterr().err
    assert str(tmp_path / "home") in errors
    assert "STARBENCH_HOME" in errors
    assert "Traceback" not in errors


def test_a_home_folder_that_cannot_be_written_gets_a_hint_to_choose_another(capsys, tmp_path):
    for where, hints in (("home/ledger.jsonl", True), ("run/journal.jsonl", False)):
        print_error(StorageError("No permission.", where=str(tmp_path / where)), [])
        assert ("STARBENCH_HOME" in capsys.readouterr().err) is hints


@pytest.mark.parametrize(
    "words", [("station", "new", "y\nPASS", "--stand-ins", "keysight"), ("calibrate", "runs", "--each")]
)
def test_a_name_writes_no_line_of_its_own(say, tmp_path, words):
    MadeRun(tmp_path / "runs/x\nPASS").begin()
    printed = "".join(say(*words)[1:])
    assert "\nPASS" not in printed
    assert r"\nPASS" in printed


REFUSED = [
    # Commands that left: where their work is done now.
    ("certificate issue runs/a --xades-key=key.pem", "dcc.xml"),
    ("calibrate runs/a --compare", "`make table1`"),
    ("history capability runs", "`starbench history table"),
    ("panel --line nine_pose", "--expect-serial"),
    # Values that do not fit their word.
    ("tell . hold 4", "`hold` takes no value"),
    ("tell . skip four", "'four' is not a valid whole number"),
    ("tell . withdraw", "`withdraw` needs the name of a job"),
    ("plan three_pose --suggest two", "'two' is not a valid whole number"),
    ("runs --since yesterday", "2026-03-01 or 2026-03-01T21:00"),
    ("keys trust nonsense", "ssh-ed25519"),
    ("station new practice.yaml --stand-ins keysight --light gardasoft", "--light"),
    # Files in the wrong place.
    ("calibrate q.yaml", "This is a queue"),
    ("calibrate results.json", "Name the folder of the run"),
    ("status journal.jsonl", "Did you mean"),
    ("passport show q.yaml", "q.yaml: "),
    *(
        (words, "--station")
        for words in ("plan three_pose bench.yaml", "plan bench.yaml", "target bench.yaml")
    ),
    ("run bench.yaml three_pose", "bench.yaml is a station file. Name it with --station.\n"),
]


@pytest.mark.parametrize(("words", "what"), REFUSED, ids=lambda value: value[:40].strip())
def test_words_that_do_not_fit_are_refused_with_what_would(say, words, what):
    Path("journal.jsonl").touch()
    Path("results.json").write_text("{}")
    Path("q.yaml").write_text("# tonight\nformat: starbench/queue/1\nname: N\n")
    Path("bench.yaml").write_text("format: starbench/station/1\n")
    status, out, err = say(*words.split())
    assert (status, out) == (2, "")
    assert what in err


@pytest.mark.parametrize("words", [("plan", "three_pose"), ("run", "three_pose")])
def test_a_fault_of_a_setting_names_the_option(say, words):
    _, _, err = say(*words, "-s", "simulated", "--set", "foo=3")
    assert "--set foo=3: " in err
    _, _, err = say(*words, "-s", "simulated", "--set", "station.nme=3")
    assert re.search(r"simulated\.yaml \(with --set\):\d+:\d+: nme: ", err)


def test_a_finished_run_is_told_as_finished_and_an_interrupted_one_how_it_goes_on(capsys, tmp_path):
    run = MadeRun(tmp_path / "run7").begin()
    run.record(1)
    message = refusal(capsys, "tell", run.folder, "hold")
    assert f"starbench resume {run.folder}" in message
    run.record_all().end()
    (run.folder / "SHA256SUMS").write_text("")
    message = refusal(capsys, "tell", run.folder, "hold")
    assert "The run has finished" in message
    assert f"starbench status {run.folder}" in message
    assert "resume" not in message


def test_the_home_folder_is_expanded_where_the_shell_does_not(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    (tmp_path / "me").mkdir()
    out_of(capsys, "station", "new", "~/bench.yaml", "--stand-ins", "keysight")
    assert (tmp_path / "me" / "bench.yaml").is_file()
    assert "on My bench" in out_of(capsys, "plan", "three_pose", "--station=~/bench.yaml")
    assert not (tmp_path / "~").exists()

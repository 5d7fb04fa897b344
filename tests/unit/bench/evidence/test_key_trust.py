"""For which moment a key is judged: replaced keys keep old reports valid, stolen ones cannot backdate unnoticed."""

import shutil
import subprocess
from datetime import UTC, datetime, timedelta

import pytest
from authorising import needs_ssh_keygen
from unchecked_seal import seal_unchecked

from bench.base.errors import EvidenceError
from bench.evidence.key_rotation import rotate
from bench.evidence.key_trust import Moments, Trust, judge_key, read_trust
from bench.evidence.keys import create_key, key_to_seal, load_key, require_usable, usable_key
from bench.evidence.personal_key import load_file_key
from bench.evidence.revoked_keys import RevokedKey, read_revoked, revoke
from bench.evidence.signers import (
    NAMESPACE,
    Signer,
    read_signers,
    replace_lines,
    time_text,
    trust,
)
from bench.evidence.ssh_keys import fingerprint
from bench.evidence.states import standing_of
from bench.evidence.timestamp import Stamp

KEY = b"\0\0\0\x0bssh-ed25519\0\0\0 " + b"k" * 32


def day(number):
    return datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=number)


def stamp(number):
    return Stamp("SHA256SUMS.tsr", "SHA256SUMS.sig", day(number), "TSA", is_laboratory=False)


def judged(*, sealed, now, proven=None, at=None, revoked=None, after=10, before=20):
    """Judge a key that is valid from day 10 to day 20."""
    signer = Signer("bench@lab", KEY, (NAMESPACE,), day(after), day(before))
    gone = (RevokedKey(KEY, day(revoked), "stolen"),) if revoked is not None else ()
    proof = stamp(proven) if proven is not None else None
    moments = Moments(day(now), proof, day(at) if at is not None else None, day(sealed), day(sealed))
    return judge_key(KEY, NAMESPACE, Trust((signer,), gone), moments)


OWN_CLOCK = "bench's own clock only"
EXPIRED = "expired 2026-01-21 00:00 UTC; the folder was sealed at 2026-01-26"
AS_ASKED = "it is accepted for 2026-01-16 00:00 UTC, as asked"
STOLEN = "revoked 2026-01-17 00:00 UTC (stolen), and no trusted time"


@pytest.mark.parametrize(
    ("case", "accepted", "says"),
    [
        # the bench's own clock alone
        ({"sealed": 15, "now": 16}, True, ""),
        ({"sealed": 15, "now": 30}, True, OWN_CLOCK),
        ({"sealed": 25, "now": 30}, False, EXPIRED),
        ({"sealed": 5, "now": 16}, False, "not valid before 2026-01-11"),
        # a trusted time stamp proves it, and goes before everything else
        ({"sealed": 15, "now": 30, "proven": 16}, True, ""),
        ({"sealed": 15, "now": 30, "proven": 5}, False, "not valid before"),
        ({"sealed": 15, "now": 30, "proven": 16, "at": 25}, True, ""),
        # a time stamp that is younger than the key's end proves nothing
        ({"sealed": 15, "now": 30, "proven": 25}, True, "The time stamp is younger than that"),
        ({"sealed": 25, "now": 30, "proven": 26}, False, "expired"),
        # the reader states the moment
        ({"sealed": 25, "now": 30, "at": 15}, True, AS_ASKED),
        ({"sealed": 15, "now": 16, "at": 25}, False, "it was judged for 2026-01-26"),
        # revoked: only a proof helps
        ({"sealed": 15, "now": 16, "revoked": 16}, False, STOLEN),
        ({"sealed": 12, "now": 30, "revoked": 16, "at": 12}, False, "no trusted time stamp proves"),
        ({"sealed": 12, "now": 30, "revoked": 16, "proven": 17}, False, "the time stamp is not older"),
        ({"sealed": 12, "now": 30, "revoked": 16, "proven": 13}, True, "but the signature existed before"),
        ({"sealed": 12, "now": 30, "revoked": 16, "proven": 16}, False, "not older"),
    ],
)
def test_the_moment_of_a_key(case, accepted, says):
    judgement = judged(**case)
    assert (judgement.principal == "bench@lab") is accepted, judgement
    assert says in (judgement.remark or judgement.fault)
    assert bool(judgement.remark or judgement.fault) is bool(says)


def test_one_of_several_lines_of_a_key_is_enough():
    lines = tuple(Signer("b@l", KEY, (NAMESPACE,), *span) for span in ((None, day(3)), (day(5), None)))
    for number, accepted in ((2, True), (4, False), (6, True)):
        moments = Moments(day(9), None, None, day(number), day(number))
        assert (judge_key(KEY, NAMESPACE, Trust(lines), moments).principal is not None) is accepted


OURS = f'namespaces="{NAMESPACE}"'
OTHERS, END = 'namespaces="git"', 'valid-before="20990101"'
UNTRUSTED = ("starbench-*,!starbench-report@v1", "!git", "", ",", "[s]*", "STARBENCH-report@v1")


@pytest.mark.parametrize(
    ("form", "may"),
    [
        *((f"a@lab {OURS} %s{more}", True) for more in ("\r\n", " b\r!", " b\u2028!", "\n#\x85!")),
        *((f'a@lab namespaces="{names}" %s', True) for names in ("starbench-*", "starbench-report@v?")),
        *((f'a@lab namespaces="{names}" %s', False) for names in UNTRUSTED),
        *((f"{text}a@lab %s", False) for text in ("# b\r", "# b\u2028", "# b\x0c", "\x0c", "\r", "!", "*,!")),
        *((f"a@lab {options} %s", False) for options in (f"{OTHERS},{OURS}", f"{OURS},{OTHERS}", f"{OURS},")),
        *((f"a@lab {options} %s", False) for options in ("namespaces", f"{OURS} {END}", f"{END},{END}")),
        (f"a@lab b,{OURS} %s", False),
        ("a@lab %s\u2028", False),
    ],
)
def test_a_key_is_trusted_as_ssh_keygen_trusts_it(tmp_path, form, may):
    home, key = tmp_path / "home", create_key(tmp_path / "home", principal="a@lab")
    folder = sealed_at(tmp_path, "run", key, datetime.now(UTC))
    (home / "allowed_signers").write_bytes((form % key.public_text).encode())
    try:
        trusted = any(not s.rejection(NAMESPACE, day(0)) for s in read_signers(home / "allowed_signers"))
    except EvidenceError as error:
        trusted = "allowed_signers:1: " not in str(error)
    assert trusted is may
    assert shutil.which("ssh-keygen") is None or ssh_accepts(home, "a@lab", folder) is may


# ------------------------------------------------------------------ replacing the key


def sealed_at(tmp_path, name, key, moment):
    folder = tmp_path / name
    folder.mkdir()
    (folder / "results.json").write_text(f'{{"run": {{"calibrated_utc": "{moment.isoformat()}"}}}}')
    seal_unchecked(folder, key)
    return folder


@needs_ssh_keygen
def test_what_the_old_key_sealed_stays_valid_and_nothing_new_does(tmp_path):
    home, now = tmp_path / "home", datetime.now(UTC)
    old = create_key(home)
    before = sealed_at(tmp_path, "before", old, now - timedelta(days=9))
    done = rotate(home, now, passphrase=None, keep_old=True)
    new = load_key(home)
    assert (done.old, done.new, new.principal) == (old.fingerprint, new.fingerprint, old.principal)
    assert fingerprint(load_file_key(done.archived, lambda _: b"").public_key) == old.fingerprint
    later = now + timedelta(days=1)
    after = sealed_at(tmp_path, "after", new, later)
    stolen = sealed_at(tmp_path, "stolen", old, later)
    listed = read_trust(home)
    standing = standing_of(before, listed, later)
    assert (standing.signer, standing.faults) == (old.principal, [])
    assert "No trusted time stamp" in standing.remarks[0]
    assert standing_of(after, listed, later).remarks == []
    assert "expired" in standing_of(stolen, listed, later).faults[0].what
    for folder, when, accepted in (
        (before, now - timedelta(days=1), True),
        (before, later, False),
        (after, later, True),
    ):
        moment = f"verify-time={time_text(when)}"
        assert ssh_accepts(home, old.principal, folder, "-O", moment) is accepted


def ssh_accepts(home, principal, folder, *more):
    """Whether stock ssh-keygen accepts the seal of a folder."""
    command = ["ssh-keygen", "-Y", "verify", "-f", home / "allowed_signers", "-I", principal, "-n", NAMESPACE]
    command += ["-s", folder / "SHA256SUMS.sig", *more]
    seal = (folder / "SHA256SUMS").read_bytes()
    return subprocess.run(command, input=seal, capture_output=True, check=False).returncode == 0


def test_a_key_that_was_replaced_during_a_run_is_loaded_again(tmp_path):
    home, now = tmp_path / "home", datetime.now(UTC)
    old = create_key(home)
    assert key_to_seal(home, old, now) is old
    rotate(home, now, passphrase=None, keep_old=False)
    later = now + timedelta(minutes=1)
    assert key_to_seal(home, old, later).fingerprint == load_key(home).fingerprint != old.fingerprint
    (home / "bench_key.pub").unlink()
    with pytest.raises(EvidenceError, match=r"cannot seal.*expired.*keys rotate"):
        key_to_seal(home, old, later)


def test_a_clock_that_was_set_back_is_told(tmp_path):
    create_key(tmp_path / "home")
    rotate(tmp_path / "home", datetime.now(UTC), passphrase=None, keep_old=False)
    message = r"not valid before.*Check the clock of this computer: it is 2001-02-03"
    with pytest.raises(EvidenceError, match=message):
        usable_key(tmp_path / "home", datetime(2001, 2, 3, tzinfo=UTC))


def test_a_validity_that_ends_earlier_is_not_prolonged(tmp_path):
    lines = [Signer("b@l", KEY, (NAMESPACE,), None, day(end)).line for end in (3, 9)]
    (tmp_path / "allowed_signers").write_text("\n".join(["# kept", *lines, ""]))
    replace_lines(tmp_path, KEY, day(5), [])
    assert (tmp_path / "allowed_signers").read_text().startswith("# kept\n")
    assert [signer.valid_before for signer in read_signers(tmp_path / "allowed_signers")] == [day(3), day(5)]


def test_there_must_be_a_key_to_replace(tmp_path):
    with pytest.raises(EvidenceError, match="no key to replace"):
        rotate(tmp_path, datetime.now(UTC), passphrase=None, keep_old=True)
    create_key(tmp_path / "home")
    (tmp_path / "home" / "bench_key.pub").write_text("nothing")
    with pytest.raises(EvidenceError, match="public key"):
        rotate(tmp_path / "home", datetime.now(UTC), passphrase=None, keep_old=True)


# ------------------------------------------------------------------ revoked keys


@needs_ssh_keygen
def test_a_revoked_key_is_refused_here_and_by_ssh_keygen(tmp_path):
    home, now = tmp_path / "home", datetime.now(UTC)
    key = create_key(home)
    folder = sealed_at(tmp_path, "sealed", key, now)
    revoke(home, RevokedKey(key.public_key, now, "laptop stolen"))
    with pytest.raises(EvidenceError, match="revoked already"):
        revoke(home, RevokedKey(key.public_key, now, "again"))
    (revoked,) = read_revoked(home / "revoked_keys")
    assert (revoked.public_key, revoked.reason) == (key.public_key, "laptop stolen")
    (fault,) = standing_of(folder, read_trust(home), now).faults
    assert fault.kind == "key"
    assert "laptop stolen" in fault.what
    with pytest.raises(EvidenceError, match=r"cannot seal: .* revoked"):
        require_usable(home, key, now)
    other = RevokedKey(create_key(tmp_path / "o").public_key, now, "lost")
    (tmp_path / "others").write_text(f"{other.line}\n")
    assert ssh_accepts(home, key.principal, folder)
    assert not ssh_accepts(home, key.principal, folder, "-r", home / "revoked_keys")
    assert ssh_accepts(home, key.principal, folder, "-r", tmp_path / "others")


def test_a_list_of_revoked_keys_of_another_form_is_refused(tmp_path, key):
    path = tmp_path / "revoked_keys"
    path.write_text(f"# by hand\n{key.public_text}\n")
    assert [revoked.text for revoked in read_revoked(path)] == ["without a date"]
    for data, mode, why in (
        (b"SSHKRL\n\0\0\0\0\x01\xff\xfe", 0o644, "KRL"),
        (b"SHA256:abc\n", 0o644, r"revoked_keys:1: This is not a line of a revoked key"),
        (b"", 0o622, "Other users can change the list of revoked keys"),
    ):
        path.write_bytes(data)
        path.chmod(mode)
        with pytest.raises(EvidenceError, match=why):
            read_revoked(path)
    for reason in ("", " ", "two\nlines"):
        with pytest.raises(EvidenceError, match="reason of one line"):
            revoke(tmp_path / "new", RevokedKey(key.public_key, day(1), reason))


# ------------------------------------------------------------------ who can change the lists


@pytest.mark.parametrize(
    ("name", "mode", "says"),
    [
        *(("allowed_signers", mode, rf".* \(mode {mode:04o}\)") for mode in (0o666, 0o664, 0o646)),
        *((".", mode, r"the folder of ") for mode in (0o777, 0o770)),
    ],
)
def test_what_others_can_change_is_refused(tmp_path, name, mode, says):
    home = tmp_path / "home"
    create_key(home)
    (home / name).chmod(mode)
    for use in (
        lambda: read_signers(home / "allowed_signers"),
        lambda: read_trust(home),
        lambda: trust(home, Signer("b@l", KEY).line),
        lambda: usable_key(home, day(1)),
    ):
        with pytest.raises(EvidenceError, match=f"{says}.*chmod go-w"):
            use()
    home.chmod(0o1777)  # the sticky bit: nobody replaces the files of others
    (home / "allowed_signers").chmod(0o644)
    assert read_signers(home / "allowed_signers")


def test_the_revoked_keys_beside_named_trusted_keys_are_used(tmp_path, key):
    create_key(tmp_path / "home")
    (tmp_path / "lab").mkdir()
    shutil.copy(tmp_path / "home" / "allowed_signers", tmp_path / "lab" / "signers")
    (tmp_path / "lab" / "revoked_keys").write_text(RevokedKey(key.public_key, day(1), "lost").line + "\n")
    assert read_trust(tmp_path / "home").revoked == []
    assert len(read_trust(tmp_path / "home", allowed_signers=tmp_path / "lab" / "signers").revoked) == 1

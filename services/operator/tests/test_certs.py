"""Keys and certificates on disk: who gets what, for how long, and what is never touched."""

import json
import re
import stat
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from armsight_operator.certs import authority
from armsight_operator.certs.folder import Folder
from armsight_operator.cli.app import main
from armsight_operator.errors import CertificateError

BEARERS = {"router": "router", "sim": "sim", "wall": "viewer"}
HOSTS = ["localhost", "127.0.0.1", "robot.local"]

Certs = Callable[..., tuple[int, str, str]]


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    folder = Folder(tmp_path / "certs")
    folder.make(BEARERS, HOSTS, days=90, ca_days=3650)
    return folder


@pytest.fixture
def certs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Certs:
    """Runs `armsight certs …` on a folder of this test: exit code, output, errors."""

    def run(command: str, *words: str) -> tuple[int, str, str]:
        code: object = 0
        try:
            main(["certs", command, *words, "--folder", str(tmp_path / "certs")])
        except SystemExit as ended:
            code = ended.code or 0
        captured = capsys.readouterr()
        assert isinstance(code, int)
        return code, captured.out, captured.err

    return run


def read(folder: Folder, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder.path / name / "certificate.pem").read_bytes())


def keys(folder: Folder) -> dict[str, bytes]:
    return {file.parent.name: file.read_bytes() for file in folder.path.glob("*/key.pem")}


def test_certificate_names_its_bearer_and_only_the_routers_serves_others(folder: Folder) -> None:
    for name, role in BEARERS.items():
        certificate = read(folder, name)
        assert (authority.name_of(certificate), authority.role_of(certificate)) == (name, role)
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        server = {ExtendedKeyUsageOID.SERVER_AUTH} if role == "router" else set()
        assert set(usage) == {ExtendedKeyUsageOID.CLIENT_AUTH} | server
        certificate.verify_directly_issued_by(read(folder, "ca"))
        assert not certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_only_the_router_is_reached_as_the_router(folder: Folder) -> None:
    assert authority.hosts_of(read(folder, "router")) == tuple(HOSTS)
    assert authority.hosts_of(read(folder, "sim")) == ("sim",)


def test_expiry_is_what_was_asked_for_and_never_beyond_the_authority(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.make({"sim": "sim"}, [], days=90, ca_days=3650)
    now = datetime.now(UTC)
    assert abs(read(folder, "sim").not_valid_after_utc - now - timedelta(days=90)) < timedelta(minutes=1)
    assert abs(read(folder, "ca").not_valid_after_utc - now - timedelta(days=3650)) < timedelta(minutes=1)
    folder.make({"control": "control"}, [], days=9999, ca_days=1)
    assert read(folder, "control").not_valid_after_utc == read(folder, "ca").not_valid_after_utc


def test_private_keys_are_their_owners_alone_and_nobody_elses(folder: Folder) -> None:
    for file in folder.path.glob("*/key.pem"):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600, file
        assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700, file.parent
    assert len(set(keys(folder).values())) == len(BEARERS) + 1
    # no folder that is handed out holds the authority's key
    for name in BEARERS:
        for file in (folder.path / name).iterdir():
            assert keys(folder)["ca"] not in file.read_bytes()


def test_made_again_keeps_everything_and_adds_who_is_new(folder: Folder) -> None:
    before = {file: file.read_bytes() for file in folder.path.glob("*/*.pem")}
    done = folder.make(BEARERS | {"door": "operator"}, HOSTS, days=1, ca_days=1)
    assert done == dict.fromkeys(BEARERS, "kept") | {"door": "made"}
    assert {file: file.read_bytes() for file in before} == before
    read(folder, "door").verify_directly_issued_by(read(folder, "ca"))


def test_renewed_certificate_is_of_the_same_key_authority_and_hosts(folder: Folder) -> None:
    old, old_keys = read(folder, "router"), keys(folder)
    folder.renew([], days=200, hosts=["10.0.0.7"])
    new = read(folder, "router")
    assert new.serial_number != old.serial_number
    assert new.not_valid_after_utc > old.not_valid_after_utc
    assert authority.hosts_of(new) == (*HOSTS, "10.0.0.7")
    assert authority.hosts_of(read(folder, "sim")) == ("sim",)
    assert keys(folder) == old_keys
    new.verify_directly_issued_by(read(folder, "ca"))


def test_keys_are_replaced_only_when_asked_for(folder: Folder) -> None:
    old = keys(folder)
    folder.renew(["sim"], days=90, new_keys=True)
    assert {name for name, key in keys(folder).items() if key != old[name]} == {"sim"}
    assert [entry.trouble for entry in folder.entries()] == [""] * 4


def test_expired_authority_signs_nothing() -> None:
    long_ago = datetime.now(UTC) - timedelta(days=30)
    expired = authority.make_authority(days=10, now=long_ago)
    key = authority.make_key().public_key()
    authority.sign(expired, key, "sim", "sim", ["sim"], days=1, now=long_ago)
    with pytest.raises(CertificateError, match="the CA expired"):
        authority.sign(expired, key, "sim", "sim", ["sim"], days=1)


@pytest.mark.parametrize(
    ("in_days", "trouble"),
    [(0, ""), (75.9, ""), (76.1, "expires in 13 days"), (89.9, "expires in 0 days"), (90.1, "expired"), (-1, "clock")],
)
def test_trouble_is_told_two_weeks_ahead(folder: Folder, in_days: float, trouble: str) -> None:
    entries = {entry.name: entry for entry in folder.entries(datetime.now(UTC) + timedelta(days=in_days))}
    assert bool(entries["sim"].trouble) == bool(trouble)
    assert trouble in entries["sim"].trouble


def test_trouble_of_another_authority_another_key_and_open_files_is_told(folder: Folder, tmp_path: Path) -> None:
    other = Folder(tmp_path / "other")
    other.make(BEARERS, HOSTS, days=90, ca_days=3650)

    def trouble(name: str) -> str:
        return next(entry.trouble for entry in folder.entries() if entry.name == name)

    assert trouble("sim") == ""
    (folder.path / "sim/certificate.pem").write_bytes((other.path / "sim/certificate.pem").read_bytes())
    assert "not signed by this CA" in trouble("sim")
    (folder.path / "wall/key.pem").write_bytes((other.path / "wall/key.pem").read_bytes())
    assert "another certificate's" in trouble("wall")
    (folder.path / "router/key.pem").chmod(0o644)
    assert "chmod 600" in trouble("router")


def test_hosts_of_the_first_router_are_not_anothers(tmp_path: Path) -> None:
    folder = Folder(tmp_path)
    folder.make({"router": "router", "edge": "router"}, ["localhost"], days=1, ca_days=1, more_hosts=["center.local"])
    assert authority.hosts_of(read(folder, "router")) == ("localhost", "center.local")
    folder.renew([], days=1, hosts=["10.0.0.1"])
    assert authority.hosts_of(read(folder, "edge")) == ("localhost",)
    folder.renew(["edge"], days=1, hosts=["edge.local"])
    assert authority.hosts_of(read(folder, "edge")) == ("localhost", "edge.local")
    assert authority.hosts_of(read(folder, "router")) == ("localhost", "center.local", "10.0.0.1")


def test_nothing_is_signed_for_a_certificate_that_somebody_put_there(folder: Folder, tmp_path: Path) -> None:
    # a viewer's folder comes back from elsewhere with more in it than was given out
    other = Folder(tmp_path / "other")
    other.make({"router": "router", "wall": "operator"}, HOSTS, days=90, ca_days=3650)
    forged = (other.path / "wall/certificate.pem").read_bytes()
    for content in (forged, (folder.path / "sim/certificate.pem").read_bytes()):
        (folder.path / "wall/certificate.pem").write_bytes(content)
        for act in (folder.roles, lambda: folder.renew([], days=1), lambda: folder.make(BEARERS, HOSTS, 1, 1)):
            with pytest.raises(CertificateError, match="not what this CA signed for wall"):
                act()
    assert authority.role_of(read(folder, "wall")) == "sim"
    folder.renew(["sim"], days=1)  # the others can go on


def test_nothing_is_made_where_others_can_put_keys_of_their_own(tmp_path: Path) -> None:
    for name in ("", "ca", "sim"):
        folder = Folder(tmp_path / f"in{name}")
        (folder.path / name).mkdir(mode=0o700, parents=True)
        folder.path.chmod(0o700)
        (folder.path / name).chmod(0o770)
        with pytest.raises(CertificateError, match="others can write to"):
            folder.make(BEARERS, HOSTS, days=1, ca_days=1)
        assert not (folder.path / name / "key.pem").exists()
        (folder.path / name).chmod(0o750)
        folder.make(BEARERS, HOSTS, days=1, ca_days=1)
        assert stat.S_IMODE((folder.path / "sim/key.pem").stat().st_mode) == 0o600


def test_links_in_place_of_folders_and_keys_are_not_followed(folder: Folder, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (folder.path / "door").symlink_to(elsewhere)
    with pytest.raises(CertificateError, match="is a link"):
        folder.make({"door": "viewer"}, HOSTS, days=1, ca_days=1)
    assert list(elsewhere.iterdir()) == []
    key = folder.path / "sim/key.pem"
    key.rename(elsewhere / "key.pem")
    key.symlink_to(elsewhere / "key.pem")
    with pytest.raises(CertificateError, match="is a link"):
        folder.renew(["sim"], days=1)
    folder.renew(["sim"], days=1, new_keys=True)
    assert not key.is_symlink()


def test_a_part_of_a_file_that_is_a_link_harms_nothing(folder: Folder, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine", encoding="ascii")
    (folder.path / "sim/.key.pem.part").symlink_to(victim)
    folder.renew(["sim"], days=1, new_keys=True)
    assert victim.read_text(encoding="ascii") == "mine"


def test_keys_that_others_can_read_sign_nothing_and_are_told(folder: Folder) -> None:
    for name, renewed in (("sim", "sim"), ("ca", "wall")):
        (folder.path / name / "key.pem").chmod(0o640)
        with pytest.raises(CertificateError, match="can be read by others: chmod 600"):
            folder.renew([renewed], days=90)
        assert "chmod 600" in next(entry.trouble for entry in folder.entries() if entry.name == name)
        (folder.path / name / "key.pem").chmod(0o600)
        folder.renew([renewed], days=90)


def test_copy_of_another_authority_is_told(folder: Folder, tmp_path: Path) -> None:
    other = Folder(tmp_path / "other")
    other.make(BEARERS, HOSTS, days=90, ca_days=3650)
    (folder.path / "sim/ca.pem").write_bytes((other.path / "sim/ca.pem").read_bytes())
    assert [entry.name for entry in folder.entries() if "of another CA" in entry.trouble] == ["sim"]
    folder.renew(["sim"], days=90)
    assert [entry.trouble for entry in folder.entries()] == [""] * 4


def test_several_at_once_make_one_authority(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "certs")
    makers = [threading.Thread(target=folder.make, args=(BEARERS, HOSTS, 1, 1)) for _ in range(8)]
    for maker in makers:
        maker.start()
    for maker in makers:
        maker.join()
    assert {entry.trouble for entry in folder.entries()} == {"expires in 0 days: renew it"}
    assert folder.roles() == BEARERS


@pytest.mark.parametrize(
    ("bearers", "hosts", "reason"),
    [
        ({"x": "king"}, [], "can't act as 'king'"),
        ({"sim": "operator"}, [], "name of the system"),
        ({"../x": "viewer"}, [], "can't be a name"),
        ({"ca": "viewer"}, [], "can't be a name"),
        ({"X": "viewer"}, [], "can't be a name"),
        ({"router": "router"}, ["a b"], "neither a host's name nor its address"),
        ({"wall": "operator"}, [], "has a certificate as viewer"),
        ({"robot": "viewer"}, ["robot"], "would pass for it"),
    ],
)
def test_what_can_not_be_is_refused_before_anything_is_made(
    folder: Folder, bearers: dict[str, str], hosts: list[str], reason: str
) -> None:
    if "router" in bearers:
        for file in (folder.path / "router").iterdir():
            file.unlink()
    before = sorted(folder.path.rglob("*"))
    with pytest.raises(CertificateError, match=re.escape(reason)):
        folder.make(bearers, hosts, days=1, ca_days=1)
    assert sorted(folder.path.rglob("*")) == before


def test_command_makes_what_zenoh_reads(certs: Certs, tmp_path: Path) -> None:
    code, out, _ = certs("make", "--name", "wall=viewer", "--host", "robot.local", "--namespace", "robots/x")
    assert code == 0
    assert "wall: made" in out
    for name in ("router", "sim", "vision", "control", "operator", "wall"):
        config = zenoh.Config.from_file(str(tmp_path / "certs" / name / "zenoh.json5"))
        assert json.loads(config.get_json("transport/link/tls/enable_mtls")) is True
        is_router = name == "router"
        assert json.loads(config.get_json("mode")) == ("router" if is_router else "client")
        if not is_router:
            assert json.loads(config.get_json("namespace")) == "robots/x"
            assert json.loads(config.get_json("connect/endpoints")) == ["tls/localhost:7447"]
    router = (tmp_path / "certs/router/zenoh.json5").read_text(encoding="utf-8")
    assert "robots/x/joints/command" in router
    assert "robots/arm/" not in router


def test_command_makes_another_router_that_speaks_for_those_behind_it(certs: Certs, tmp_path: Path) -> None:
    code, _, _ = certs("make", "--router", "edge=sim,vision")
    assert code == 0

    def may_put(router: str, other: str) -> set[str]:
        text = (tmp_path / "certs" / router / "zenoh.json5").read_text(encoding="utf-8")
        control = json.loads(text.split("\n", 2)[2])["access_control"]
        (subject,) = (subject for subject in control["subjects"] if other in subject["cert_common_names"])
        (policy,) = (policy for policy in control["policies"] if subject["id"] in policy["subjects"])
        rules = [rule for rule in control["rules"] if rule["id"] in policy["rules"]]
        puts = [rule["key_exprs"] for rule in rules if rule["flows"] == ["ingress"] and rule["messages"] == ["put"]]
        return {key.removeprefix("robots/arm/") for keys in puts for key in keys}

    behind = may_put("router", "edge")
    assert {"camera/*/image", "joints/positions", "health/sim", "health/vision"} <= behind
    assert not {"joints/command", "health/control"} & behind
    assert {"joints/command", "target", "health/control"} <= may_put("edge", "router")
    # the rights of everybody else on either are the same
    assert may_put("edge", "vision") == may_put("router", "vision") < behind
    # said again each time, as its rules are written anew each time
    code, _, error = certs("make")
    assert code == 1
    assert "--router edge=sim,vision" in error


def test_command_shows_and_warns(certs: Certs, tmp_path: Path) -> None:
    certs("make", "--days", "30")
    code, out, _ = certs("show")
    assert code == 0
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert {"ca", "router", "sim", "vision", "control", "operator"} <= set(lines)
    assert "29" in lines["sim"].split()
    certs("renew", "sim", "--days", "10")
    code, out, _ = certs("show")
    assert code == 1
    assert "expires in 9 days: renew it" in out
    # a folder that was handed out shows its own
    (tmp_path / "certs").rename(tmp_path / "all")
    (tmp_path / "all/sim").rename(tmp_path / "certs")
    code, out, _ = certs("show")
    assert code == 1
    assert len(out.splitlines()) == 2


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        (["show"], 1, "armsight certs make"),
        (["renew"], 1, "has no CA"),
        (["make", "--name", "wall"], 2, "NAME=ROLE"),
        (["make", "--listen", "tcp/0.0.0.0:7447"], 2, "tls/HOST:PORT"),
        (["make", "--connect", "nowhere"], 2, "nowhere"),
        (["make", "--namespace", "a//b"], 2, "a//b"),
        (["make", "--days", "0"], 2, "--days"),
        (["make", "--router", "edge"], 2, "NAME=ROLE,ROLE"),
        (["make", "--router", "edge=king"], 1, "can't speak for king"),
    ],
)
def test_mistakes_end_with_one_line(certs: Certs, words: list[str], code: int, reason: str) -> None:
    ended, out, error = certs(*words)
    assert (ended, out) == (code, "")
    assert reason in error
    assert error.count("\n") == 1


def test_no_command_prints_a_key(certs: Certs, tmp_path: Path) -> None:
    said = "".join(
        "".join(map(str, certs(*words))) for words in (["make"], ["make"], ["renew", "--new-keys"], ["show"])
    )
    assert "sim" in said
    assert "PRIVATE KEY" not in said
    broken = tmp_path / "certs/ca/key.pem"
    secret = broken.read_text(encoding="ascii").splitlines()[1]
    broken.write_text(f"broken {secret}", encoding="ascii")
    code, _, error = certs("renew")
    assert code == 1
    assert "is not a private key" in error
    assert secret not in said + error

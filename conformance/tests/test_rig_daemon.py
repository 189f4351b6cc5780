"""The rig over the control API of a daemon: `axistwin conform ... --rig http://HOST:PORT`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trustme
from click.testing import CliRunner
from daemon_process import daemon

from axistwin_conformance.base.errors import RigError, UsageError
from axistwin_conformance.cli import conform
from axistwin_conformance.families.mac.axis.rig_controls import AXIS_CONTROLS
from axistwin_conformance.transport.remote_twin import RemoteTwin
from axistwin_conformance.transport.rig import TwinRig, choose_rig
from axistwin_conformance.transport.serial import SerialTransport, open_target

pytestmark = pytest.mark.system

TOKEN = "0123456789abcdef0123456789abcdef"
WHAT = ("mac23:0", "mac23:1", "mac34-1:5", "--pty", "./line", "--control", "127.0.0.1:0", "--json")


class Rack:
    """A daemon with three modules: where its line and its control API are."""

    def __init__(self, port: str, url: str) -> None:
        self.port, self.url = port, url

    def rig(self, target: SerialTransport, address: int, device: str = "") -> TwinRig:
        """The rig for the module at that address."""
        return TwinRig(target, address, AXIS_CONTROLS, RemoteTwin(self.url + device, address))


@pytest.fixture(scope="module")
def rack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rack]:
    """It wants a token, which is in the environment."""
    folder: Path = tmp_path_factory.mktemp("rack")
    with (
        pytest.MonkeyPatch.context() as patch,
        daemon(folder, *WHAT, environment={"AXISTWIN_CONTROL_TOKEN": TOKEN}) as process,
    ):
        patch.setenv("AXISTWIN_CONTROL_TOKEN", TOKEN)
        yield Rack(str(folder / "line"), process.event()["control"])


@pytest.fixture
def target(rack: Rack) -> Iterator[SerialTransport]:
    """The line."""
    opened = open_target(rack.port, 38400)
    yield opened
    opened.close()


def value(rack: Rack, address: int, name: str) -> Any:
    """What the daemon says of a control."""
    return RemoteTwin(rack.url, address).controls[name].value


def test_every_control_of_a_twin_elsewhere_is_worked(rack: Rack, target: SerialTransport) -> None:
    """Of the module with that address; `reset` brings all of it back to rest."""
    rig = rack.rig(target, 1)
    worked = [
        ("positive_stop", True, "inputs.positive_stop", True),
        ("supply", 30.0, "supply_volts", 30.0),
        ("temperature", 50.0, "temperature_celsius", 50.0),
        ("hold", True, "load.held", True),
        ("micro_cut", True, "fault_bits", 1),
        ("power", False, "power", False),
    ]
    for capability, wanted, name, shown in worked:
        begun_ns, ended_ns = rig.work(capability, wanted)
        assert begun_ns < ended_ns
        assert value(rack, 1, name) == shown
    assert not value(rack, 0, "inputs.positive_stop")
    rig.reset()
    usual = [("positive_stop", False), ("supply", 24.0), ("hold", False), ("power", True)]
    names = {capability: name for capability, _, name, _ in worked}
    assert [(each, value(rack, 1, names[each])) for each, _ in usual] == usual
    assert not rig.is_exact


def test_the_url_may_name_the_twin(rack: Rack, target: SerialTransport) -> None:
    """One at another address is not the device that is judged."""
    rack.rig(target, 5, "/mac34-1:5").work("turn", 3)
    assert value(rack, 5, "position") == 3
    for device, reason in (
        ("/mac34-1:5", r"no twin at address 0, but mac34-1:5 \(address 5\)"),
        ("/mac32:0", "did you mean mac23:0"),
    ):
        with pytest.raises(RigError, match=reason):
            rack.rig(target, 0, device)


def test_a_fault_that_a_model_has_not_is_told(rack: Rack, target: SerialTransport) -> None:
    """In the daemon's own words."""
    with pytest.raises(RigError, match="a mac23 has no fault 'encoder'"):
        rack.rig(target, 0).work("encoder", True)


def choose(url: str) -> Any:
    """What `--rig URL` chooses for a run that may use it."""
    return choose_rig(url, None, "./line", is_allowed=True, capabilities=frozenset(AXIS_CONTROLS))


def test_a_rig_that_cannot_be_had_is_one_clear_line(
    rack: Rack, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody there, another word, a token that is missing: before anything is sent."""
    assert choose(rack.url).words(is_default=False) == ["--rig", rack.url]
    with pytest.raises(UsageError, match=r"no daemon answers at http://127\.0\.0\.1:1 .*--control"):
        choose("http://127.0.0.1:1")
    with pytest.raises(UsageError, match="--rig twn: choose one of twin, prompt, command, or"):
        choose("twn")
    monkeypatch.delenv("AXISTWIN_CONTROL_TOKEN")
    with pytest.raises(UsageError, match="a token is needed"):
        choose(rack.url)


def test_a_daemon_with_a_certificate_is_a_rig_by_its_ca(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which the environment names; one that is not trusted, or is no CA, is told in one line."""
    authority = trustme.CA()
    both, trusted, other = (tmp_path / name for name in ("both.pem", "ca.pem", "other.pem"))
    authority.issue_cert("127.0.0.1").private_key_and_cert_chain_pem.write_to_path(str(both))
    authority.cert_pem.write_to_path(str(trusted))
    trustme.CA().cert_pem.write_to_path(str(other))
    words = ("mac23", "--control", "127.0.0.1:0", "--control-certificate", str(both), "--json")
    with daemon(tmp_path, *words) as process:
        url = process.event()["control"]
        monkeypatch.setenv("AXISTWIN_CONTROL_CA", str(trusted))
        assert choose(url).words(is_default=False) == ["--rig", url]
        RemoteTwin(url, 0).controls["inputs.reference"].set(True)
        assert RemoteTwin(url, 0).controls["inputs.reference"].value is True
        for file, reason in ((other, "not trusted"), (tmp_path / "none", "No such file")):
            monkeypatch.setenv("AXISTWIN_CONTROL_CA", str(file))
            with pytest.raises(UsageError, match=f"{reason}.*"):
                choose(url)


def test_a_daemon_that_ends_is_the_rigs_trouble(tmp_path: Path) -> None:
    """Also of an input that a device may lack: nobody has looked."""
    with daemon(tmp_path, "mac23", "--control", "127.0.0.1:0", "--json") as process:
        url = process.event()["control"]
        twin = RemoteTwin(url, 0)
        opened = open_target(str(tmp_path / "mac23"), 38400)
        rig = TwinRig(opened, 0, AXIS_CONTROLS, twin)
        opened.close()
        process.end()
    with pytest.raises(RigError, match="no daemon answers"):
        rig._work(rig_act("positive_stop"))


def rig_act(capability: str) -> Any:
    """Turn it on."""
    from axistwin_conformance.transport.rig import Act

    return Act(AXIS_CONTROLS[capability], True)


RACK = """
[control]
address = "127.0.0.1:0"

[[line]]
name = "press"
devices = "mac23"
pty = "./press"

[[line]]
name = "saw"
devices = "mac34-1"
pty = "./saw"
"""


@pytest.mark.strength(seconds=20)
def test_a_rack_of_two_workers_is_judged_with_its_own_control_api(tmp_path: Path) -> None:
    """Each module by the same URL, whichever process has it."""
    (tmp_path / "rack.toml").write_text(RACK)
    words = ("rack.toml", "--workers", "2", "--json")
    with daemon(tmp_path, *words, command="rack") as process:
        (url,) = {process.event()["control"] for _ in range(2)}
        for model, line in (("mac23", "press"), ("mac34-1", "saw")):
            result = CliRunner().invoke(
                conform,
                [
                    *(model, "--port", str(tmp_path / line), "--rig", f"{url}/{model}:0@{line}"),
                    *("--allow", "motion,stored,rig", "--max-travel", "2000"),
                    "a_hardware_stop_ends_motion_of_its_sign",
                ],
            )
            assert result.exit_code == 0, result.output
            assert "1 pass" in result.output or "conforms" in result.output


@pytest.mark.strength(seconds=40)
def test_a_daemon_is_judged_with_its_own_control_api(rack: Rack) -> None:
    """Stops, reset and a power cut in a move: with verdicts, and nothing for want of a rig."""
    checks = ("held_in_reset_the_module_is_deaf", "a_hardware_stop_ends_motion_of_its_sign")
    result = CliRunner().invoke(
        conform,
        [
            *("mac23", "--port", rack.port, "--rig", rack.url, "--allow", "motion,stored,rig"),
            *("--neighbour", "1", "--neighbour", "5", "--max-travel", "2000", *checks),
        ],
    )
    assert result.exit_code == 0, result.output
    assert "2 pass" in result.output or "conforms" in result.output

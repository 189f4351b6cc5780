"""The rig: whatever works the device's inputs, supply, temperature and shaft while it is judged.

    TwinRig      the handles that the port or bus object of a twin in this process offers
    CommandRig   a command of the user's, run once per act, without a shell
    PromptRig    the person at the terminal, asked to do it

Rules.

1. A rig does only what it can (`capabilities`); asked for more it raises `CannotDo`, and what was
   to be judged is then *not run*, with that reason.
2. Every act is bracketed in time: a verb returns the target's clock (ns) before and after it, and
   what is judged allows for the act anywhere between.  Only the twin's acts take no time.
3. `reset` brings everything that was worked back to rest, on every way out; it tries all of it
   even if a part fails, then raises one `RigError` naming what is left.

The contract of a command: the words of the template, each with {verb}, {name} and {value} filled
in, are run as they are.  Exit status 0: done (or, to `can`: able).  3: cannot do this.  Anything
else, or more than 30 s: it went wrong, and its last line of output says why.
"""

from __future__ import annotations

import select
import shlex
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, TextIO

from axistwin_conformance.base.check import CAPABILITIES
from axistwin_conformance.base.errors import CannotDo, RigError, UsageError
from axistwin_conformance.transport.kinds import LINE, TransportKind
from axistwin_conformance.transport.transport import Transport, is_twin_url

INPUTS: Final = ("reference", "positive_stop", "negative_stop", "reset")
FAULTS: Final = ("micro_cut", "amplifier", "encoder")

OF_A_CONTROLLER: Final = frozenset({"power", "flag", "status", "program", "battery"})
OF_AN_AXIS: Final = frozenset(CAPABILITIES) - (OF_A_CONTROLLER - {"power"})
KINDS: Final = ("twin", "prompt", "command")
COMMAND_TIMEOUT_S: Final = 30.0
CANNOT_STATUS: Final = 3
PUT_BACK_TIMEOUT_S: Final = 120.0  # nobody at the terminal must not hold a port for ever
VIRTUAL: Final = "time=virtual"  # in what opens a twin: time passes only while the suite waits
PLACEHOLDERS: Final = ("{verb}", "{name}", "{value}")

Window = tuple[int, int]  # the target's clock before and after an act, ns
Notify = Callable[[bool, str], None]  # a question is open (True) or was answered, and its text


@dataclass(frozen=True, slots=True)
class Act:
    """One thing to do: `verb` and `name` as a command gets them; `value` None means rest."""

    verb: str
    name: str
    value: bool | float | int | None

    @property
    def capability(self) -> str:
        """The capability that it takes."""
        return self.name if self.verb in ("input", "fault") else self.verb

    @property
    def text(self) -> str:
        """The value as a command gets it: on, off, a number, or rest."""
        if self.value is None:
            return "rest"
        if isinstance(self.value, bool):
            return "on" if self.value else "off"
        return f"{self.value:+d}" if self.verb == "turn" else f"{self.value:g}"

    @property
    def is_at_rest(self) -> bool:
        """True if it leaves nothing to put back."""
        if self.verb == "turn" or self.value is None:
            return True
        return self.value is (self.verb in _ON_AT_REST)

    @property
    def undone(self) -> Act:
        """The act that brings it back to rest."""
        rest = None if self.verb in ("supply", "temperature") else self.verb in _ON_AT_REST
        return Act(self.verb, self.name, rest)


_ON_AT_REST: Final = ("power", "program")
# What must be put back first: a held shaft, before anything drives it; what a start needs.
_RESET_ORDER: Final = (
    "hold", "fault", "input", "flag", "status", "battery", "temperature", "supply", "power",
    "program",
)  # fmt: skip


class Rig(ABC):
    """The verbs, the same for every kind; `is_exact` if values and instants are as asked for."""

    is_exact = False

    def __init__(self, target: Transport, capabilities: frozenset[str]) -> None:
        self._target = target
        self._disturbed: dict[tuple[str, str], Act] = {}
        self.capabilities = capabilities

    @abstractmethod
    def _work(self, act: Act) -> None:
        """Do it; raises CannotDo or RigError."""

    @property
    def is_disturbed(self) -> bool:
        """True while something is not at rest."""
        return bool(self._disturbed)

    def set_input(self, name: str, active: bool) -> Window:
        """Close (active) or open the contact of an input of `INPUTS`."""
        return self._do(Act("input", name, active))

    def set_supply(self, volts: float) -> Window:
        """Set the supply voltage."""
        return self._do(Act("supply", "volts", volts))

    def set_temperature(self, celsius: float) -> Window:
        """Set the temperature that the module measures."""
        return self._do(Act("temperature", "celsius", celsius))

    def power_off(self) -> Window:
        """Cut the supply."""
        return self._do(Act("power", "supply", False))

    def power_on(self) -> Window:
        """Apply the supply."""
        return self._do(Act("power", "supply", True))

    def hold_shaft(self, held: bool) -> Window:
        """Hold the shaft so that the motor cannot turn it, or let it go."""
        return self._do(Act("hold", "shaft", held))

    def turn_shaft(self, increments: int) -> Window:
        """Turn the shaft by hand; positive is clockwise, seen facing the flange."""
        return self._do(Act("turn", "shaft", increments))

    def fault(self, name: str, present: bool) -> Window:
        """Let a fault of `FAULTS` be there, or be gone."""
        return self._do(Act("fault", name, present))

    def set_flag(self, number: int, on: bool) -> Window:
        """Have the machine turn an input, timer or motor flag of a controller on, or off again."""
        return self._do(Act("flag", str(number), on))

    def set_status(self, bit: int, on: bool) -> Window:
        """Bring about the condition of a bit of a controller's status word, or end it."""
        return self._do(Act("status", str(bit), on))

    def run_program(self, running: bool) -> Window:
        """Start a controller's macroprogram, or stop it."""
        return self._do(Act("program", "macroprogram", running))

    def set_battery(self, flat: bool) -> Window:
        """Let the battery of a controller's memory be empty, or put a good one in."""
        return self._do(Act("battery", "memory", flat))

    def require(self, capability: str) -> None:
        """Raise CannotDo if the rig cannot do that."""
        if capability not in self.capabilities:
            raise CannotDo(f"the rig cannot do this: no way that it {CAPABILITIES[capability]}")

    def reset(self) -> None:
        """Bring everything that was worked back to rest; raises RigError naming what is left."""
        left = []
        for act in sorted(self._disturbed.values(), key=lambda act: _RESET_ORDER.index(act.verb)):
            try:
                self._do(act.undone)
            except (CannotDo, RigError) as error:
                left.append(f"{act.verb} {act.name} is still {act.text} ({error})")
        self._disturbed.clear()
        if left:
            raise RigError("the rig is not at rest: " + "; ".join(left))

    def _do(self, act: Act) -> Window:
        assert act.capability in CAPABILITIES, f"no rig knows {act}"
        self.require(act.capability)
        before_ns = self._target.now_ns
        if not act.is_at_rest:  # before it is done: half done is disturbed too
            self._disturbed[act.verb, act.name] = act
        try:
            self._work(act)
        except CannotDo:
            self._disturbed.pop((act.verb, act.name), None)
            raise
        if act.is_at_rest:
            self._disturbed.pop((act.verb, act.name), None)
        self._target.mark(f"rig: {act.verb} {act.name} {act.text}")
        window = before_ns, self._target.now_ns
        if self._target.travel_guard is not None:  # the counter may not be what it was
            self._target.travel_guard.worked(act.capability, window)
        return window


class TwinRig(Rig):
    """Works the twin behind the target, by the handles that every twin offers."""

    def __init__(
        self, target: Transport, address: int, capabilities: frozenset[str] = OF_AN_AXIS
    ) -> None:
        super().__init__(target, capabilities)
        self.is_exact = VIRTUAL in target.description  # else time passes while we are at it
        self._twin = _twin_at(target, address)
        self._usual = {
            name: getattr(self._twin, name)
            for name in ("supply_volts", "temperature_celsius")
            if name.partition("_")[0] in capabilities
        }

    def _work(self, act: Act) -> None:
        try:
            self._handle(act)
        except Exception as error:  # whatever a twin raises, the run goes on without it
            raise RigError(f"{act.verb} {act.name} {act.text}: {error}") from error

    def _wire(self, act: Act) -> None:
        """Work a contact.  One that this device has not does nothing, as at a real terminal block:
        whether the device reacts is for the check to see."""
        try:
            setattr(self._twin.inputs, act.name, act.value)
        except Exception as error:
            self._target.mark(f"rig: nothing is wired to it: {error}")

    def _handle(self, act: Act) -> None:
        twin, value = self._twin, act.value
        match act.verb:
            case "input":
                self._wire(act)
            case "supply" | "temperature":
                name = f"{act.verb}_{act.name}"
                setattr(twin, name, self._usual[name] if value is None else value)
            case "power":
                (twin.power_on if value else twin.power_off)()
            case "hold":
                twin.load.held = value
            case "turn":
                twin.push(value)
            case "fault":
                twin.set_fault(act.name, value)
            case "flag":
                twin.flags[int(act.name)] = value
            case "status":
                twin.set_status(int(act.name), value)
            case "program":
                (twin.start_program if value else twin.stop_program)()
            case "battery":
                twin.battery = "flat" if value else "good"


def _twin_at(target: Transport, address: int) -> Any:
    """The twin with that address behind the target; raises RigError if there is none."""
    for twin in target.twins:
        if twin.address == address:
            return twin
    raise RigError(f"no twin has address {address} behind {target.description}")


class CommandRig(Rig):
    """Runs the user's command for every act; see the contract above."""

    def __init__(
        self,
        target: Transport,
        template: str,
        capabilities: frozenset[str],
        timeout_s: float = COMMAND_TIMEOUT_S,
    ) -> None:
        super().__init__(target, capabilities)
        self._template = template
        self._timeout_s = timeout_s

    def _work(self, act: Act) -> None:
        words = (act.verb, act.name, act.text)
        if not run_command(self._template, words, self._timeout_s):
            raise CannotDo(f"the rig's command cannot do {' '.join(words)}")


def run_command(template: str, words: tuple[str, str, str], timeout_s: float) -> bool:
    """Run a rig's command; True if done, False if it cannot; raises RigError in one line."""
    command = command_line(template, words)
    told = shlex.join(command)
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout_s,
            check=False,
            start_new_session=True,  # Ctrl-C ends the run, not half an act
        )
    except subprocess.TimeoutExpired as error:
        raise RigError(f"{told} did not end within {timeout_s:g} s") from error
    except OSError as error:
        raise RigError(f"{told} cannot be run: {error.strerror}") from error
    if done.returncode not in (0, CANNOT_STATUS):
        lines = done.stdout.decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "no output")
        raise RigError(f"{told} ended with status {done.returncode}: {last}")
    return done.returncode == 0


def command_line(template: str, words: tuple[str, str, str]) -> list[str]:
    """The command's words; what is filled in never becomes more than the word it stands in."""
    filled = []
    for part in shlex.split(template):
        for placeholder, word in zip(PLACEHOLDERS, words, strict=True):
            part = part.replace(placeholder, word)
        filled.append(part)
    return filled


class Terminal(Protocol):
    """Where a person is asked."""

    def ask(self, text: str, timeout_s: float | None = None) -> str | None:
        """Show the text; return the line typed, None at the end of input or after the time-out."""


class Console:
    """The terminal of this process: questions on standard error, answers from standard input."""

    def __init__(self, source: TextIO | None = None, sink: TextIO | None = None) -> None:
        self._source = source or sys.stdin
        self._sink = sink or sys.stderr

    def ask(self, text: str, timeout_s: float | None = None) -> str | None:
        """Ask, and wait for a line."""
        print(text, end=" ", file=self._sink, flush=True)
        if timeout_s is not None and not select.select([self._source], [], [], timeout_s)[0]:
            return None
        return self._source.readline() or None


class PromptRig(Rig):
    """Asks the person at the terminal: Enter when it is done, s to skip."""

    def __init__(
        self,
        target: Transport,
        terminal: Terminal | None = None,
        notify: Notify = lambda is_open, text: None,
        capabilities: frozenset[str] = OF_AN_AXIS,
    ) -> None:
        super().__init__(target, capabilities)
        self._terminal = terminal or Console()
        self._notify = notify
        self._is_resetting = False

    def reset(self) -> None:
        """Ask to put everything back; waits at most two minutes for each."""
        self._is_resetting = True
        try:
            super().reset()
        finally:
            self._is_resetting = False

    def _work(self, act: Act) -> None:
        order = in_words(act)
        keys = "[Enter = done]" if self._is_resetting else "[Enter = done, s = skip]"
        limit_s = PUT_BACK_TIMEOUT_S if self._is_resetting else None
        self._notify(True, order)
        try:
            answer = self._terminal.ask(f"rig: {order} {keys}", limit_s)
        finally:
            self._notify(False, order)
        if self._is_resetting:
            if answer is None:
                raise RigError("nobody said it was put back")
        elif answer is None or answer.strip().lower().startswith("s"):
            self.capabilities -= {act.capability}  # not to be asked for again
            raise CannotDo(f"skipped at the terminal: {order}")


_ORDERS: Final[Mapping[tuple[str, str], tuple[str, str]]] = {
    ("input", "reset"): ("Hold the reset input low.", "Release the reset input."),
    ("power", "supply"): ("Switch the supply on.", "Switch the supply off."),
    ("hold", "shaft"): ("Hold the shaft fast.", "Let the shaft go."),
    ("supply", "volts"): ("Set the supply to {} V.", "Set the supply back to its usual voltage."),
    ("temperature", "celsius"): (
        "Bring the module to {} °C.",
        "Bring the module back to its usual temperature.",
    ),
    ("program", "macroprogram"): ("Start the macroprogram.", "Stop the macroprogram."),
    ("battery", "memory"): (
        "Take the battery of the memory away.",
        "Put a good battery of the memory in.",
    ),
    ("turn", "shaft"): ("Turn the shaft by about {} increments (+ is clockwise).", ""),
}


def in_words(act: Act) -> str:
    """The act as one asks a person for it."""
    name = act.name.replace("_", " ")
    forms = {
        "input": (f"Close the contact of the {name} input.", f"Open the {name} contact."),
        "fault": (f"Let there be this fault: {name}.", f"End the fault: {name}."),
        "flag": (f"Work the machine until flag {name} is on.", f"Let flag {name} go off again."),
        "status": (
            f"Bring about the condition of status bit {name}.",
            f"End the condition of status bit {name}.",
        ),
    }
    done, undone = _ORDERS.get((act.verb, act.name)) or forms[act.verb]
    return (undone if act.value is False or act.value is None else done).format(act.text)


# --- which rig a run has -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RigChoice:
    """The rig of a run, as chosen on the command line; `kind` is empty for none."""

    kind: str = ""
    command: str = ""
    capabilities: frozenset[str] = field(default=frozenset())

    def open(self, target: Transport, address: int, notify: Notify) -> Rig | None:
        """The rig for one open target; raises RigError if the target offers no handles."""
        match self.kind:
            case "twin":
                return TwinRig(target, address, self.capabilities)
            case "prompt":
                return PromptRig(target, notify=notify, capabilities=self.capabilities)
            case "command":
                return CommandRig(target, self.command, self.capabilities)
        return None

    def words(self, is_default: bool) -> list[str]:
        """The options that choose it again; nothing where it is the default."""
        if not self.kind or (self.kind == "twin" and is_default):
            return []
        return ["--rig", self.kind, *(["--rig-command", self.command] if self.command else [])]


def choose_rig(
    kind: str | None,
    command: str | None,
    url: str,
    *,
    is_allowed: bool,
    transport_kind: TransportKind = LINE,
    capabilities: frozenset[str] = OF_AN_AXIS,
) -> RigChoice:
    """Read `--rig` and `--rig-command`; raises UsageError in one line.

    A twin in this process is its own rig.  A command is asked what it can do of `capabilities`,
    those that serve the kind of device, unless the run may not use a rig anyway.
    """
    is_twin = is_twin_url(url)
    if kind is None:
        kind = "command" if command is not None else "twin" if is_twin else ""
    if command is not None and kind != "command":
        raise UsageError(f"--rig-command goes with --rig command, not with --rig {kind}")
    if kind == "twin" and not is_twin:
        where = f"{transport_kind.option} {transport_kind.twin}..."
        raise UsageError(f"--rig twin needs a twin in this process: {where}")
    if kind == "prompt" and is_allowed and not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise UsageError("--rig prompt needs a terminal with somebody to ask; try --rig command")
    if kind != "command":
        return RigChoice(kind, "", capabilities if kind else frozenset())
    if command is None:
        raise UsageError("--rig command needs --rig-command 'PROGRAM {verb} {name} {value}'")
    _check_template(command)
    able = ask_capabilities(command, sorted(capabilities)) if is_allowed else frozenset()
    return RigChoice(kind, command, able)


def _check_template(template: str) -> None:
    try:
        words = shlex.split(template)
    except ValueError as error:
        raise UsageError(f"--rig-command {template!r}: {error}") from error
    missing = [name for name in PLACEHOLDERS if not any(name in word for word in words)]
    if missing:
        raise UsageError(f"--rig-command {template!r} lacks {', '.join(missing)}")


def ask_capabilities(template: str, names: Sequence[str]) -> frozenset[str]:
    """Ask a rig's command for each capability: verb `can`, its name, value `-`."""
    try:
        return frozenset(
            name for name in names if run_command(template, ("can", name, "-"), COMMAND_TIMEOUT_S)
        )
    except RigError as error:
        raise UsageError(f"--rig-command: {error} (0 = can, 3 = cannot)") from error

"""The rig: whatever works the device's inputs, supply, temperature and shaft while it is judged.

    TwinRig      the controls of a twin: in this process, behind its port or bus object, or of a
                 daemon, over HTTP
    CommandRig   a command of the user's, run once per act, without a shell
    PromptRig    the person at the terminal, asked to do it

Rules.

1. A rig works what the table of a family has, as far as it can (`capabilities`); asked for more it
   raises `CannotDo`, and what was to be judged is then *not run*, with that reason.
2. Every act is bracketed in time: `work` returns the target's clock (ns) before and after it, and
   what is judged allows for the act anywhere between.  Only the twin's acts take no time.
3. `reset` brings everything that was worked back to rest, on every way out; it tries all of it
   even if a part fails, then raises one `RigError` naming what is left.

The contract of a command: the words of the template, each with {verb}, {name} and {value} filled
in, are run as they are.  Exit status 0: done (or, to `can`: able).  3: cannot do this.  Anything
else, or more than 30 s: it went wrong, and its last line of output says why.
"""

from __future__ import annotations

import re
import select
import shlex
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, TextIO, TypeAlias, cast

from axistwin_conformance.base.errors import CannotDo, RigError, UsageError
from axistwin_conformance.transport.kinds import LINE, TransportKind
from axistwin_conformance.transport.remote_twin import SCHEMES, Daemon, RefusedByTwin, RemoteTwin
from axistwin_conformance.transport.transport import Transport, is_twin_url

KINDS: Final = ("twin", "prompt", "command")
COMMAND_TIMEOUT_S: Final = 30.0
CANNOT_STATUS: Final = 3
PUT_BACK_TIMEOUT_S: Final = 120.0  # nobody at the terminal must not hold a port for ever
VIRTUAL: Final = "time=virtual"  # in what opens a twin: time passes only while the suite waits
PLACEHOLDERS: Final = ("{verb}", "{name}", "{value}")

Window = tuple[int, int]  # the target's clock before and after an act, ns
Notify = Callable[[bool, str], None]  # a question is open (True) or was answered, and its text


@dataclass(frozen=True, slots=True)
class RigControl:
    """What a rig may work of a device.

    `capability`: what checks call it, and name as their need.  `name`: what a command gets behind
    the verb; empty: the number that it is worked with.  `words`: it, behind "a rig that".
    `orders`: to a person, to turn it on or set it, and to turn it off or set it back; {name} and
    {value} are filled in.  `done`: the same once it is done.  `twin`: the control of a twin, {} the
    number; or the two, with their values, that turn it on and off.  `verb`: the capability unless
    given.  `rest`: its value when nobody works it; None: as it was found.  `is_step`: nothing of it
    is put back.
    `is_optional`: at a device without it, it does nothing.
    """

    capability: str
    name: str
    words: str
    orders: tuple[str, str]
    done: tuple[str, str]
    twin: str | Mapping[bool, tuple[str, str | None]]
    verb: str = ""
    rest: bool | None = False
    is_step: bool = False
    is_optional: bool = False


RigControls: TypeAlias = Mapping[str, RigControl]


def rig_controls(*controls: RigControl) -> RigControls:
    """The table of a family, by capability, in the order in which all is put back: a held shaft
    before anything drives it, the supply after what works without it."""
    return {control.capability: control for control in controls}


POWER: Final = RigControl(
    "power",
    "supply",
    "switches the supply off and on",
    ("Switch the supply on.", "Switch the supply off."),
    ("the power was switched on", "the power was switched off"),
    "power",
    rest=True,
)  # of every device


@dataclass(frozen=True, slots=True)
class Act:
    """One thing to do; `value` None means rest."""

    control: RigControl
    value: bool | float | None
    number: int | None = None

    @property
    def words(self) -> tuple[str, str, str]:
        """Verb, name and value as a command gets them, the value on, off, a number, or rest."""
        control, value = self.control, self.value
        if value is None or isinstance(value, bool):
            text = {None: "rest", True: "on", False: "off"}[value]
        else:
            text = f"{value:+}" if control.is_step else f"{value:g}"
        return control.verb or control.capability, control.name or str(self.number), text

    def __str__(self) -> str:
        return " ".join(self.words)

    @property
    def is_at_rest(self) -> bool:
        """True if it leaves nothing to put back."""
        return self.control.is_step or self.value is self.control.rest

    @property
    def undone(self) -> Act:
        """The act that brings it back to rest."""
        return Act(self.control, self.control.rest, self.number)

    @property
    def order(self) -> str:
        """What a person is asked to do."""
        return self._said(self.control.orders)

    @property
    def done(self) -> str:
        """What has been done, as a clause."""
        return self._said(self.control.done)

    def of_twin(self) -> tuple[str, bool | float | str | None]:
        """The control of a twin that does it, and the value to set; None: one without a value, or
        the value that it was found with."""
        if isinstance(self.control.twin, str):
            return self.control.twin.format(self.number), self.value
        return self.control.twin[bool(self.value)]

    def _said(self, texts: tuple[str, str]) -> str:
        text = texts[self.value is None or self.value is False]
        return text.format(name=self.words[1], value=self.words[2])


def act_done(controls: RigControls, clause: str) -> Act | None:
    """The act that has been done, by its clause (`Act.done`); None: none of these controls."""
    for control in controls.values():
        for is_on, done in zip((True, False), control.done, strict=True):
            pattern = re.escape(done).replace(r"\{name\}", "(?P<name>[0-9]+)")
            found = re.fullmatch(pattern.replace(r"\{value\}", "(?P<value>[-+0-9.]+)"), clause)
            if found is None:
                continue
            said = found.groupdict()
            rest = None if control.rest is None else False
            value = float(said["value"]) if "value" in said else True if is_on else rest
            return Act(control, value, int(said["name"]) if "name" in said else None)
    return None


class Rig(ABC):
    """Works the controls of a family, in so far as it can; `is_exact` if values and instants are as
    asked for."""

    is_exact = False

    def __init__(self, target: Transport, controls: RigControls) -> None:
        self._target, self._controls = target, controls
        self._disturbed: dict[tuple[str, int | None], Act] = {}
        self.capabilities = frozenset(controls)

    @abstractmethod
    def _work(self, act: Act) -> None:
        """Do it; raises CannotDo or RigError."""

    @property
    def is_disturbed(self) -> bool:
        """True while something is not at rest."""
        return bool(self._disturbed)

    def work(self, capability: str, value: bool | float, *, number: int | None = None) -> Window:
        """Turn a control on or off, or set it; `number`: which one, where it has numbers."""
        return self._do(Act(self._controls[capability], value, number))

    def require(self, capability: str) -> None:
        """Raise CannotDo if the rig cannot do that."""
        if capability not in self.capabilities:
            words = self._controls[capability].words
            raise CannotDo(f"the rig cannot do this: no way that it {words}")

    def reset(self) -> None:
        """Bring everything that was worked back to rest; raises RigError naming what is left."""
        left, order = [], list(self._controls.values())
        for act in sorted(self._disturbed.values(), key=lambda act: order.index(act.control)):
            try:
                self._do(act.undone)
            except (CannotDo, RigError) as error:
                left.append("{} {} is still {} ({})".format(*act.words, error))
        self._disturbed.clear()
        if left:
            raise RigError("the rig is not at rest: " + "; ".join(left))

    def _do(self, act: Act) -> Window:
        key = act.control.capability, act.number
        self.require(act.control.capability)
        before_ns = self._target.now_ns
        if not act.is_at_rest:  # before it is done: half done is disturbed too
            self._disturbed[key] = act
        try:
            self._work(act)
        except CannotDo:
            self._disturbed.pop(key, None)
            raise
        if act.is_at_rest:
            self._disturbed.pop(key, None)
        self._target.mark(f"rig: {act.done}")
        window = before_ns, self._target.now_ns
        if self._target.travel_guard is not None:  # the counter may not be what it was
            disturbed = {name for name, _ in self._disturbed}
            name, number = act.control.capability, act.number
            self._target.travel_guard.worked(name, window, disturbed, number)
        return window


class TwinRig(Rig):
    """Works a twin, the one behind the target unless given, by the names of its controls."""

    def __init__(
        self,
        target: Transport,
        address: int,
        controls: RigControls,
        twin: RemoteTwin | None = None,
    ) -> None:
        super().__init__(target, controls)
        self.is_exact = VIRTUAL in target.description  # else time passes while we are at it
        self._twin = _twin_at(target, address) if twin is None else cast(Any, twin)
        self._usual = {
            name: self._twin.controls[control.twin].value
            for name, control in controls.items()
            if control.rest is None
        }

    def _work(self, act: Act) -> None:
        control = act.control
        try:
            path, value = act.of_twin()
            if act.value is None:
                value = self._usual.get(control.capability)
            self._twin.controls[path].set(value)
        except RigError as error:  # a daemon that does not answer
            raise RigError(f"{act}: {error}") from error
        except Exception as error:  # whatever a twin raises, the run goes on without it
            if not control.is_optional:
                raise RigError(f"{act}: {error}") from error
            # As at a real terminal block: whether the device reacts is for the check to see.
            self._target.mark(f"rig: nothing is wired to it: {error}")


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
        controls: RigControls,
        template: str,
        timeout_s: float = COMMAND_TIMEOUT_S,
    ) -> None:
        super().__init__(target, controls)
        self._template = template
        self._timeout_s = timeout_s

    def _work(self, act: Act) -> None:
        if not run_command(self._template, act.words, self._timeout_s):
            raise CannotDo(f"the rig's command cannot do {act}")


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
        controls: RigControls,
        terminal: Terminal | None = None,
        notify: Notify = lambda is_open, text: None,
    ) -> None:
        super().__init__(target, controls)
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
        keys = "[Enter = done]" if self._is_resetting else "[Enter = done, s = skip]"
        limit_s = PUT_BACK_TIMEOUT_S if self._is_resetting else None
        self._notify(True, act.order)
        try:
            answer = self._terminal.ask(f"rig: {act.order} {keys}", limit_s)
        finally:
            self._notify(False, act.order)
        if self._is_resetting:
            if answer is None:
                raise RigError("nobody said it was put back")
        elif answer is None or answer.strip().lower().startswith("s"):
            self.capabilities -= {act.control.capability}  # not to be asked for again
            raise CannotDo(f"skipped at the terminal: {act.order}")


# --- which rig a run has -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RigChoice:
    """The rig of a run, as chosen on the command line.

    `kind`: empty for none, one of KINDS, or the URL of a daemon's control API.
    """

    kind: str = ""
    command: str = ""
    capabilities: frozenset[str] = field(default=frozenset())

    def open(
        self, target: Transport, address: int, controls: RigControls, notify: Notify
    ) -> Rig | None:
        """The rig for one open target; raises RigError if the target is no twin's."""
        rig: Rig
        match self.kind:
            case "twin":
                rig = TwinRig(target, address, controls)
            case "prompt":
                rig = PromptRig(target, controls, notify=notify)
            case "command":
                rig = CommandRig(target, controls, self.command)
            case url if url.startswith(SCHEMES):
                rig = TwinRig(target, address, controls, RemoteTwin(url, address))
            case _:
                return None
        rig.capabilities = self.capabilities
        return rig

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
    capabilities: Set[str],
    transport_kind: TransportKind = LINE,
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
    if kind not in ("", *KINDS) and not kind.startswith(SCHEMES):
        raise UsageError(
            f"--rig {kind}: choose one of {', '.join(KINDS)}, or the URL of a daemon's control "
            f"API, such as http://127.0.0.1:8080"
        )
    if kind.startswith(SCHEMES) and is_allowed:
        _check_daemon(kind)
    if kind == "twin" and not is_twin:
        twin = f"{transport_kind.option} {transport_kind.twin}..."
        where = twin if transport_kind.twin else f"leave out {transport_kind.option}"
        raise UsageError(f"--rig twin needs a twin in this process: {where}")
    if kind == "prompt" and is_allowed and not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise UsageError("--rig prompt needs a terminal with somebody to ask; try --rig command")
    if kind != "command":
        return RigChoice(kind, "", frozenset(capabilities if kind else ()))
    if command is None:
        raise UsageError("--rig command needs --rig-command 'PROGRAM {verb} {name} {value}'")
    _check_template(command)
    able = ask_capabilities(command, sorted(capabilities)) if is_allowed else frozenset()
    return RigChoice(kind, command, able)


def _check_daemon(url: str) -> None:
    try:
        Daemon.of(url).ask("GET", "devices")
    except (RigError, ValueError, RefusedByTwin) as error:
        raise UsageError(
            f"--rig {url}: {error}; start the twins with 'axistwin run ... --control HOST:PORT'"
        ) from error


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

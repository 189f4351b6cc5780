"""A picture of a motion: its path in planes, and position and rate of each axis over time.

One theme for paper and for dark pages: nothing behind the drawing, and every colour as far from
white as from the background of a dark page.  Axes are told apart by the form of their lines too.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from axistwin.cli.plot.track import MotionTrack
from axistwin.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

WORDS: Final = "#787878"
LINES: Final = ("#0077bb", "#d55e00", "#009a70", "#b5609f")
"""Of the axes, in their order; told apart with any kind of colour vision (after Okabe and Ito)."""

FORMS: Final = ("-", "--", "-.", ":")
FORMATS: Final = (".png", ".svg")
WIDTH_INCHES: Final = 8.0
_PANEL_INCHES: Final = 1.9
_PATH_INCHES: Final = 3.0
_DOTS_PER_INCH: Final = 150
_SAME_SCALE_MAX: Final = 20
"""Ratio of the spans of two axes up to which their plane has one scale."""

_STYLE: Final[dict[str, Any]] = {
    "font.size": 9,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "text.color": WORDS,
    "axes.edgecolor": WORDS,
    "axes.labelcolor": WORDS,
    "axes.titlecolor": WORDS,
    "xtick.color": WORDS,
    "ytick.color": WORDS,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "axes.grid": True,
    "grid.color": WORDS,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.labelcolor": WORDS,
    "legend.handlelength": 3.0,
    "svg.fonttype": "none",
    "svg.hashsalt": "axistwin",
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}


def check_target(path: str) -> None:
    """Raises UsageError for a name whose form is unknown, and if matplotlib is not installed."""
    if Path(path).suffix.lower() not in FORMATS:
        raise UsageError(f"{path}: the name of the picture ends with {' or '.join(FORMATS)}")
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UsageError(
            "plot needs matplotlib, which is not installed: pip install 'matplotlib>=3.9'"
        ) from None


def draw(
    track: MotionTrack,
    axes: Sequence[int],
    planes: Sequence[tuple[int, int]],
    title: str,
    target: str,
) -> None:
    """Write the picture.  Raises UsageError if that is not possible."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        height = 2 * _PANEL_INCHES + 0.6 + (_PATH_INCHES if planes else 0.0)
        figure: Any = Figure(figsize=(WIDTH_INCHES, height), layout="constrained")
        figure.suptitle(title, fontsize=11)
        if planes:
            above, below = figure.subfigures(2, 1, height_ratios=(_PATH_INCHES, 2 * _PANEL_INCHES))
            for panel, plane in zip(_row(above, len(planes)), planes, strict=True):
                panel.locator_params(nbins=max(3, 7 - 2 * len(planes)))
                _path(panel, track, plane)
            panel.legend(loc="best", handlelength=1.0, fontsize=8)
        else:
            below = figure.subfigures(1, 1)
        _over_time(below, track, axes)
        try:
            figure.savefig(target, dpi=_DOTS_PER_INCH, metadata=_metadata(target))
        except OSError as error:
            raise UsageError(
                f"{target}: cannot be written ({error.strerror}); choose another file"
            ) from None


def _metadata(target: str) -> dict[str, Any]:
    """Nothing that makes two pictures of one motion differ."""
    return {"Date": None} if target.lower().endswith(".svg") else {"Software": "axistwin"}


def _row(figure: Any, count: int) -> list[Any]:
    return list(figure.subplots(1, count, squeeze=False)[0])


def _path(panel: Any, track: MotionTrack, plane: tuple[int, int]) -> None:
    """Where two axes went together."""
    across, up = (track.places(axis) for axis in plane)
    panel.plot(across, up, color=LINES[0], marker="." if track.is_read_out else "", clip_on=False)
    panel.plot(across[:1], up[:1], "o", color=WORDS, fillstyle="none", label="start", zorder=3)
    panel.plot(across[-1:], up[-1:], "s", color=WORDS, label="end", zorder=3, markersize=5)
    names = [track.names[axis] for axis in plane]
    panel.set_xlabel(f"{names[0]} [{track.unit}]")
    panel.set_ylabel(f"{names[1]} [{track.unit}]")
    spans = sorted(max(places) - min(places) for places in (across, up))
    if spans[0] * _SAME_SCALE_MAX >= spans[1]:
        panel.set_aspect("equal", adjustable="datalim")


def _over_time(figure: Any, track: MotionTrack, axes: Sequence[int]) -> None:
    """Position and rate of each axis."""
    places, rates = figure.subplots(2, 1, sharex=True)
    form = {"marker": ".", "markersize": 3} if track.is_read_out else {}
    drawn = "steps-post" if track.is_read_out else "default"
    for axis in axes:
        look = {"color": LINES[axis % len(LINES)], "linestyle": FORMS[axis % len(FORMS)]}
        places.plot(track.times_s, track.places(axis), label=track.names[axis], **look, **form)
        rates.plot(track.times_s, track.speeds(axis), drawstyle=drawn, **look)
    places.set_ylabel(f"position [{track.unit}]")
    rates.set_ylabel(f"rate [{track.unit}/s]")
    rates.set_xlabel("time [s]")
    rates.axhline(0, color=WORDS, linewidth=0.8)
    figure.align_ylabels((places, rates))
    if len(axes) > 1:
        places.legend(ncols=len(axes), loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.0)

"""What Hypothesis is used for here: to draw.  Failing runs are shrunk and kept elsewhere."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final
from unittest import mock

from hypothesis import HealthCheck, Phase, configuration, settings
from hypothesis.internal.conjecture import providers
from hypothesis.internal.constants_ast import Constants

STEPS: Final = 50


def generate_only(examples: int, steps: int = STEPS) -> settings:
    """So many examples (of so many steps, for a state machine), and no more than that.

    Its shrinker knows nothing of operations and would need thousands of runs where `shrink` needs
    some dozens; it keeps no notes, and finds nothing unhealthy.
    """
    return settings(
        max_examples=examples,
        stateful_step_count=steps,
        database=None,
        deadline=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
        print_blob=False,
        report_multiple_bugs=False,
    )


@contextmanager
def reproducible() -> Iterator[None]:
    """Have one seed draw the same on every machine and for every version of this source.

    Hypothesis draws, now and then, a constant that it has found in the source of the modules that
    are loaded: any change of a line would change what a seed plays.  And it keeps notes in a folder
    where it is started: not in the user's.
    """
    before = vars(configuration)["__hypothesis_home_directory"]
    with tempfile.TemporaryDirectory() as folder:
        configuration.set_hypothesis_home_dir(folder)
        providers.CONSTANTS_CACHE.cache.clear()
        try:
            with mock.patch.object(providers, "_get_local_constants", Constants):
                yield
        finally:
            providers.CONSTANTS_CACHE.cache.clear()
            configuration.set_hypothesis_home_dir(before)

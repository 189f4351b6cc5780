"""What is seen of a bench under each value of each quirk: the registry of such cases."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from axistwin.devices.switches import Quirk

Bench = TypeVar("Bench")
Scenario = Callable[[Bench], object]


class Cases(dict[str, tuple[Scenario[Bench], dict[str, object], dict[str, Any]]]):
    """By quirk: the scenario, what is seen under each value, and the settings it is played over."""

    def case(
        self, name: str, seen: Mapping[str, object], **base: Any
    ) -> Callable[[Scenario[Bench]], Scenario[Bench]]:
        """Register what is ``seen`` under each value of quirk ``name``, over ``base`` settings."""

        def register(scenario: Scenario[Bench]) -> Scenario[Bench]:
            assert name not in self
            self[name] = (scenario, dict(seen), base)
            return scenario

        return register

    def played(self) -> list[tuple[str, str]]:
        """Every quirk with every value, for ``parametrize``."""
        return [(name, value) for name, (_, seen, _) in self.items() for value in seen]

    def check_complete(self, quirks: Mapping[str, Quirk], ambiguities: str) -> None:
        """Every quirk has a case with all its values, default first; numbers and texts have two at
        least.  ``ambiguities``: how the IDs of their sources begin."""
        assert self.keys() == quirks.keys()
        for name, quirk in quirks.items():
            values = list(self[name][1])
            assert values[0] == quirk.default, name
            if quirk.kind in ("choice", "bool"):
                assert list(quirk.allowed) == values, name
            else:
                assert len(values) >= 2, name
            assert quirk.source.startswith(ambiguities), name
            assert quirk.doc, name

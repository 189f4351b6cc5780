"""Seeds of named streams."""

from axistwin.kernel.seed import Draws, derive_seed


def test_streams_have_their_own_stable_seeds() -> None:
    """The same run and name give the same seed for ever; another run or name another one."""
    assert derive_seed(0, "skew") == derive_seed(0, "skew")
    assert len({derive_seed(0, "skew"), derive_seed(1, "skew"), derive_seed(0, "noise")}) == 3
    assert derive_seed(7, "a") == 0x681EBD31F1942012


def test_draws_are_those_of_splitmix() -> None:
    """The published numbers of its seed 1234567, so that traces stay what they are."""
    draws = Draws(1234567)
    assert [draws.below(1 << 64) for _ in range(3)] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
    ]
    assert {Draws(0).below(1) for _ in range(5)} == {0}

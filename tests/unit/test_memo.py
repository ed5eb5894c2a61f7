"""Results kept for arguments that can be compared; the others are computed anew."""

from spiral.types.cache import kept


def test_a_result_is_kept_where_its_arguments_have_a_hash():
    calls = []

    @kept(2)
    def doubled(value, by=2):
        calls.append(value)
        return [value * by] if isinstance(value, int) else value * by

    assert doubled(3) is doubled(3)
    assert doubled(3, by=3) == [9]
    assert doubled([1]) == [1, 1]
    assert doubled([1]) == [1, 1]
    assert calls == [3, 3, [1], [1]]


def test_one_model_is_traced_once():
    from spiral_plugins.effects.dissipative import LinearDamping
    from spiral_plugins.effects.restoring import LinearStiffness
    from spiral_plugins.systems.oscillator import Oscillator

    from spiral.physics.trace import trace

    first = trace(Oscillator(), (LinearStiffness(),))
    assert trace(Oscillator(), (LinearStiffness(),)) is first
    assert trace(Oscillator(), (LinearDamping(),)) is not first

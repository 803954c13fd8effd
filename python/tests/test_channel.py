"""Messages of any trainer's environments by `murmurate.Channel`: who hears whom, how late, and what."""

import copy
import pickle

import numpy as np
import pytest

from murmurate import Channel

BUFFERS = ("heard", "age", "index", "said")


def rolled(channel, steps=20):
    """All that is heard in some steps."""
    seen = []
    for _ in range(steps):
        channel.step()
        seen.append([getattr(channel, name).copy() for name in BUFFERS])
    return seen


def equal(one, other):
    return all(np.array_equal(a, b) for step, others in zip(one, other) for a, b in zip(step, others))


def test_messages_arrive_late_with_their_contents():
    channel = Channel(2, 3, delay_s=0.07, content=4)
    for step in range(4):
        channel.step(content=np.full((2, 3, 4), step, np.float32))
        others = ~np.eye(3, dtype=bool)[None].repeat(2, 0)
        assert np.array_equal(channel.heard, others if step > 0 else np.zeros_like(others))
        assert np.array_equal(channel.index, np.where(channel.heard, step - 1, -1))
        assert np.allclose(channel.age, np.where(channel.heard, 0.1, 0.0))
        assert np.array_equal(channel.said, np.where(channel.heard, step - 1.0, 0.0)[..., None].repeat(4, 3))


def test_range_silence_and_addressees_decide_who_hears():
    channel = Channel(1, 3, range_m=1.5, hold_s=0.05)
    line = np.array([[[0, 0], [1, 0], [2, 0]]], np.float32)
    channel.step(line)
    assert channel.heard[0].tolist() == [[False, True, False], [True, False, True], [False, True, False]]
    sends, to = np.array([[False, True, True]]), np.array([[-1, 0, -1]], np.int32)
    channel.step(line, sends=sends, to=to)
    assert channel.heard[0].tolist() == [[False, True, False], [False, False, True], [False, False, False]]


def test_a_shared_channel_loses_what_does_not_fit():
    shares = []
    for size in (100, 1400):
        channel = Channel(64, 8, radio="wifi", spread_s=0.05, hold_s=0.2)
        for _ in range(40):
            channel.step(bytes=size)
        shares.append(channel.heard.sum() / (64 * 56))
    assert shares[0] > 0.95 and shares[1] < 0.8


def test_copies_pickles_and_states_continue_to_the_bit_on_any_number_of_threads():
    options = {"radio": "wifi", "loss": 0.2, "burst_share": 0.1, "delay_s": (0.0, 0.1), "tail_s": 0.02, "spread_s": 0.03}
    channel = Channel(40, 4, seed=5, **options)
    rolled(channel)
    others = [copy.deepcopy(channel), pickle.loads(pickle.dumps(channel)), Channel(40, 4, threads=3, seed=1, **options)]
    others[2].set_state(channel.state())
    expected = rolled(channel)
    assert all(equal(expected, rolled(other)) for other in others)
    channel.reset(seed=5)
    assert equal(rolled(channel), rolled(Channel(40, 4, seed=5, **options)))
    mask = np.arange(40) == 7
    channel.reset(mask)
    assert not channel.heard[7].any() and channel.heard[8].any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loss": 2}, "loss: 2"),
        ({"loss": "much"}, "loss: 'much' is no number"),
        ({"radio": "wire"}, "radio: 'wire' is neither a preset (wifi, "),
        ({"delay_s": (0.2, 0.1)}, "delay_s: 0.2"),
        ({"delay_s": "late"}, "delay_s: a <class 'str'> is neither a number nor a pair"),
        ({"hold_s": 0.01}, "hold_s: 0.01"),
        ({"burst_share": 0.9, "burst_s": 0.05}, "burst_share: good times would be shorter than a step"),
        ({"burst_s": 2.0}, "burst_s: it has no effect without burst_share"),
        ({"threads": 0}, "threads: 0 is not 1 to 1024"),
    ],
)
def test_wrong_arguments_are_named(options, message):
    with pytest.raises(ValueError) as error:
        Channel(2, 3, **options)
    assert str(error.value).startswith(message)


def test_wrong_arrays_are_named_and_change_nothing():
    channel = Channel(2, 3, range_m=1.0, content=1)
    here, said = np.zeros((2, 3, 2), np.float32), np.zeros((2, 3, 1), np.float32)
    for arguments, message in (
        ({"content": said}, "position: missing"),
        ({"position": here}, "content: missing"),
        ({"position": here.astype(float), "content": said}, "position: its type is float64 and not float32"),
        ({"position": here[:1], "content": said}, "position: its shape is [1, 3, 2] and not [2, 3, 2]"),
        ({"position": here + np.nan, "content": said}, "position: the value at flat index 0 is NaN"),
        ({"position": here, "content": said, "to": np.full((2, 3), 3, np.int32)}, "to: the value at flat index 0 is 3"),
        ({"position": here, "content": said, "bytes": 0}, "bytes: 0 is not 1 to 65507"),
    ):
        with pytest.raises(ValueError) as error:
            channel.step(**arguments)
        assert str(error.value).startswith(message), arguments
    assert not channel.heard.any() and channel.index.max() == -1
    state = channel.state()
    for wrong in (b"", state[:-1], state[:40] + b"x" + state[41:], Channel(3, 3).state()):
        with pytest.raises(ValueError) as error:
            channel.set_state(wrong)
        assert str(error.value).startswith("state: ")

"""Environments whose agents speak, with what they say over a channel. Each is skipped where its tool is not installed."""

import copy
import pickle

import numpy as np
import pytest
from needs import need


def made(task, num_envs=4, *, seed=0, max_steps=None, **options):
    """Environment of VMAS with speech over a channel."""
    need("vmas")
    from vmas import make_env

    from murmurate.vmas import spoken

    return make_env(spoken(task, **options), num_envs, seed=seed, max_steps=max_steps)


def said_in(env, step):
    """Actions in which agents stand and say the number of the step."""
    import torch

    sizes = [env.get_agent_action_size(agent) for agent in env.agents]
    moves = [env.agents[at].action.action_size for at in range(len(sizes))]
    return [
        torch.cat([torch.zeros(env.num_envs, move), torch.full((env.num_envs, size - move), (step + 1) / 100)], 1)
        for size, move in zip(sizes, moves)
    ]


@pytest.mark.parametrize("task", ["simple_speaker_listener", "simple_reference", "simple_crypto", "simple_world_comm"])
def test_scenarios_of_vmas_that_speak_pass_torchrls_check(task):
    need("vmas")
    need("torchrl")
    import torch
    from torchrl.envs.libs.vmas import VmasEnv
    from torchrl.envs.utils import MarlGroupMapType, check_env_specs

    from murmurate.vmas import spoken

    def env():
        scenario = spoken(task, radio="wifi", loss=0.3, delay_s=(0.0, 0.2))
        return VmasEnv(scenario, num_envs=6, max_steps=7, seed=0, group_map=MarlGroupMapType.ONE_GROUP_PER_AGENT)

    check_env_specs(env())
    first, second = env(), env()
    rolled = []
    for each in (first, second):
        torch.manual_seed(3)
        each.set_seed(3)
        rolled.append(each.rollout(12, break_when_any_done=False))
    assert all(torch.equal(rolled[0][key], rolled[1][key]) for key in rolled[0].keys(True, True))


@pytest.mark.parametrize("delay_s, steps", [(0.0, 0), (0.1, 0), (0.15, 1), (0.3, 2)])
def test_what_is_said_is_heard_as_many_steps_later_as_its_delay(delay_s, steps):
    env = made("simple_reference", delay_s=delay_s)
    assert not env.reset()[0][:, -10:].any()
    for step in range(6):
        seen = env.step(said_in(env, step))[0]
        # A step is 0.1 s, and what is said in it is heard at its end at the earliest.
        expected = np.float32(max(0, step - steps + 1) / 100)
        for observation in seen:
            assert (observation[:, -10:] == expected).all(), (step, observation[0])
        assert (env.world.agents[0].state.c == np.float32((step + 1) / 100)).all(), "the world knows what was said"


def test_nothing_that_is_lost_far_away_or_of_a_former_episode_is_heard():
    need("vmas")
    import torch

    for options in ({"loss": 1.0}, {"range_m": 0.0}):
        env = made("simple_reference", **options)
        assert not any(env.step(said_in(env, step))[0][1][:, -10:].any() for step in range(4))
    env = made("simple_reference")
    env.step(said_in(env, 0))
    env.reset_at(2)
    seen = env.get_from_scenario(get_observations=True, get_rewards=False, get_infos=False, get_dones=False)[0]
    assert seen[0][:, -10:].any(1).tolist() == [True, True, False, True]
    # Without delay and loss a channel changes nothing: neither layouts nor observations.
    from vmas import make_env

    ours, theirs = made("simple_reference", seed=5), make_env("simple_reference", 4, seed=5)
    for step in range(5):
        if step == 3:
            # Environments of VMAS share one stream of random numbers.
            ours.reset(seed=7), theirs.reset(seed=7)
        seen = [env.step(said_in(env, step))[0] for env in (ours, theirs)]
        assert all(torch.equal(mine, other) for mine, other in zip(*seen))


def test_a_speaker_hears_nothing_of_a_silent_listener_and_is_heard_with_its_share():
    env = made("simple_speaker_listener", 200, loss=0.4, hold_s=0.1)
    heard = []
    for step in range(30):
        heard.append(env.step(said_in(env, step))[0][1][:, -3:].any(1).double().mean())
    assert abs(float(sum(heard)) / 30 - 0.6) < 0.03
    assert not env.scenario._spoken.channel.heard[:, 0, 1].any()


def test_environments_with_speech_are_copied_and_stored():
    need("vmas")
    import torch
    from vmas import make_env

    from murmurate.vmas import spoken

    env = made("simple_reference", loss=0.5)
    env.step(said_in(env, 0))
    other = copy.deepcopy(env)
    for step in range(1, 6):
        seen = [each.step(said_in(each, step))[0] for each in (env, other)]
        assert torch.equal(seen[0][0], seen[1][0])
    assert other.world.zero_grad.__self__ is other.scenario
    other.to("meta")
    assert all(said.device.type == "meta" for said in [other.scenario._heard, *other.scenario._said])
    restored = make_env(pickle.loads(pickle.dumps(spoken("simple_reference", loss=1.0))), 2)
    assert restored.scenario._options == {"loss": 1.0} and not restored.step(said_in(restored, 0))[0][0][:, -10:].any()


def test_scenarios_that_do_not_fit_are_refused():
    need("vmas")
    from murmurate.vmas import spoken

    with pytest.raises(ValueError, match="scenario: its agents say nothing"):
        made("navigation")
    with pytest.raises(ValueError, match="num_envs: it is that of the environment"):
        spoken("simple_reference", num_envs=3)
    with pytest.raises(ValueError, match="loss: "):
        made("simple_reference", loss=2.0)
    with pytest.raises(ValueError, match="scenario: .* is neither a name nor a class of a scenario of VMAS"):
        spoken(spoken("simple_reference"))
    assert type(spoken("simple_reference")) is type(spoken("simple_reference")), "a class is made once"


@pytest.mark.parametrize("task", ["simple_speaker_listener_v4", "simple_reference_v3", "simple_crypto_v3", "simple_world_comm_v3"])
def test_environments_of_mpe_that_speak(task):
    need("pettingzoo")
    module = need(f"mpe2.{task}")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from murmurate.pettingzoo import spoken

    parallel_api_test(spoken(module.parallel_env(), loss=0.2, delay_s=(0.0, 0.2)), num_cycles=100)
    parallel_seed_test(lambda: spoken(module.parallel_env(), loss=0.2, radio="wifi"), num_cycles=50)
    # Without delay and loss a channel changes nothing; with loss 1 nothing is heard.
    envs = [spoken(module.parallel_env()), module.parallel_env(), spoken(module.parallel_env(), loss=1.0)]
    first = [env.reset(seed=3)[0] for env in envs]
    for agent in envs[1].agents:
        envs[1].action_space(agent).seed(1)
    differ = False
    for _ in range(10):
        actions = {agent: envs[1].action_space(agent).sample() for agent in envs[1].agents}
        ours, theirs, deaf = (env.step(actions) for env in envs)
        assert all(np.array_equal(ours[0][agent], theirs[0][agent]) for agent in actions) and ours[1] == theirs[1]
        differ = differ or any(not np.array_equal(deaf[0][agent], theirs[0][agent]) for agent in actions)
    assert differ and set(first[0]) == set(actions)
    assert np.array_equal(envs[0].state(), envs[1].unwrapped.state())


def test_what_is_said_in_mpe_is_heard_as_many_steps_later_as_its_delay():
    need("pettingzoo")
    module = need("mpe2.simple_reference_v3")
    from murmurate.pettingzoo import spoken

    env = spoken(module.parallel_env(), delay_s=0.25)
    env.reset(seed=1)
    said = []
    for step in range(8):
        said.append(step % 10)
        seen = env.step({agent: 5 * said[-1] for agent in env.agents})[0]
        for observation in seen.values():
            expected = np.eye(10)[said[step - 2]] if step >= 2 else np.zeros(10)
            assert (observation[-10:] == expected).all(), step
    with pytest.raises(ValueError, match="env: its agents say nothing"):
        spoken(need("mpe2.simple_spread_v3").parallel_env())


def test_episodes_of_equal_layouts_lose_other_words():
    need("vmas")
    import torch
    from vmas.scenarios import load

    class Fixed(load("simple_reference.py").Scenario):
        def reset_world_at(self, env_index=None):
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(1)
                super().reset_world_at(env_index)

    env = made(Fixed, loss=0.5, hold_s=0.1)

    def heard(seed=None):
        env.reset(seed=seed)
        return torch.stack([env.step(said_in(env, step))[0][0][:, -10:].any(1) for step in range(20)]).tolist()

    first, second = heard(), heard()
    assert first != second, "each episode has losses of its own"
    assert heard(3) == heard(3) != first


def test_wrappers_of_mpe_go_around_the_channel():
    module = need("mpe2.simple_reference_v3")
    from pettingzoo.utils.wrappers import BaseParallelWrapper

    from murmurate.pettingzoo import spoken

    class Scaled(BaseParallelWrapper):
        pass

    with pytest.raises(ValueError, match="env: Scaled is beneath the channel: .* wrap what spoken"):
        spoken(Scaled(module.parallel_env()))
    assert set(Scaled(spoken(module.parallel_env())).reset(seed=1)[0]) == {"agent_0", "agent_1"}


def test_wrong_actions_change_nothing_in_mpe():
    module = need("mpe2.simple_reference_v3")
    from murmurate.pettingzoo import spoken

    first, other = (spoken(module.parallel_env(continuous_actions=True), delay_s=0.1) for _ in range(2))
    for env in (first, other):
        env.reset(seed=1)
    actions = {agent: np.full(15, 0.5, np.float32) for agent in first.agents}
    for wrong, words in ((np.full(15, np.nan), "it is not finite"), (np.zeros(3), "its shape is")):
        with pytest.raises(ValueError, match=rf"actions\['agent_1'\]: {words}"):
            first.step(actions | {"agent_1": wrong})
    for _ in range(3):
        seen = [env.step(actions)[0] for env in (first, other)]
        assert all(np.array_equal(seen[0][agent], seen[1][agent]) for agent in actions)


def test_gradients_end_where_a_segment_of_truncated_back_propagation_does():
    need("vmas")
    import torch
    from vmas import make_env

    from murmurate.vmas import spoken

    env = make_env(spoken("simple_reference", delay_s=0.15), 3, seed=0, grad_enabled=True)
    words = [torch.full((3, 10), 0.5, requires_grad=True) for _ in range(6)]
    for begin in (0, 3):
        for word in words[begin : begin + 3]:
            seen = env.step([torch.cat([torch.zeros(3, 2), word * word], 1), torch.zeros(3, 12)])[0]
            if word is words[3]:
                # Said before the end of the segment, and heard after it.
                assert (seen[1][:, -10:] == 0.25).all() and not seen[1].requires_grad
        seen[1][:, -10:].sum().backward()
        env.world.zero_grad()
    assert [0.0 if word.grad is None else float(word.grad.sum()) for word in words] == [0, 30, 0, 0, 30, 0]


def test_gradients_reach_a_speaker_from_what_was_heard_as_late_as_it_was():
    need("vmas")
    import torch
    from vmas import make_env

    from murmurate.vmas import spoken

    env = make_env(spoken("simple_reference", delay_s=0.15), 3, seed=0, grad_enabled=True)
    assert env.scenario._spoken.channel.memory == 13
    words = [torch.full((3, 10), 0.5, requires_grad=True) for _ in range(6)]
    for step, word in enumerate(words):
        if step == 3:
            env.reset_at(1)
        seen = env.step([torch.cat([torch.zeros(3, 2), word], 1), torch.zeros(3, 12)])[0]
    seen[1][:, -10:].sum().backward()
    # A message of two steps ago; the environment that has begun anew has heard it, too.
    assert [0.0 if word.grad is None else float(word.grad.sum()) for word in words] == [0, 0, 0, 0, 30, 0]
    seen = env.step([torch.cat([torch.zeros(3, 2), words[0]], 1), torch.zeros(3, 12)])[0]
    assert (seen[1][:, -10:] == 0.5).all()
    with pytest.raises(ValueError, match="actions: what an agent says is not finite"):
        env.scenario.world.agents[0].action.c = torch.full((3, 10), torch.inf)
        env.scenario.pre_step()

"""Names of the scenarios as environments of Gymnasium, which reads this file when it is imported itself."""

#: Names of environments by scenario.
NAMES = {"passage": "murmurate/Passage-v0", "swap": "murmurate/Swap-v0", "flocking": "murmurate/Flocking-v0"}


def register() -> None:
    """Registers the environments, unless that is done: once where Gymnasium finds this package, once where it is imported."""
    from gymnasium.envs.registration import register, registry

    for scenario, name in NAMES.items():
        if name not in registry:
            register(
                name,
                entry_point="murmurate.gymnasium:TeamEnv",
                vector_entry_point="murmurate.gymnasium:TeamVectorEnv",
                kwargs={"scenario": scenario},
            )

"""Environments that need more memory than there is are a MemoryError, also under a limit of the process."""

import resource

from lib_expect import expect, refused

import murmurate

large = {"num_envs": 2**20, "message": "action", "message_size": 1024}
refused(lambda: murmurate.VecEnv(**large), MemoryError, "num_envs: 1048576 environments of 5 robots need")
resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30, 3 * 2**30))
refused(lambda: murmurate.VecEnv(num_envs=2**19, message="observations"), MemoryError, "GiB of memory")
env = murmurate.VecEnv(num_envs=2**12, message="observations")
expect(env.num_envs == 4096, "after that, nothing can be made")
kept = [env]
for _ in range(1000):
    try:
        kept.append(kept[-1].copy())
    except MemoryError:
        break
else:
    expect(False, "a thousand copies fit into 3 GiB")

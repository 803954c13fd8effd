"""`policy check` refuses a policy for a scenario that the program does not have, as `sim` does."""
from lib_policy_files import load, refused, run, sys, write

for name in ["python_full.safetensors", "conv_gatv2.safetensors"]:
    header, manifest, tensors = load(name)
    football = write("football.safetensors", header, {**manifest, "scenario": "football"}, tensors)
    refused(["policy", "check", football], "'football'", "passage")
    refused(["sim", "--policy", football], "'football'")
    code, out, err = run("policy", "check", write("whole.safetensors", header, manifest, tensors))
    if code != 0 or "can run it" not in out:
        sys.exit(f"the unchanged file: {code} {out}{err}")

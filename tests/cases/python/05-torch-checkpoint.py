"""What is no policy file, or no checkpoint, is called by its name with what to do."""
import torch

from lib_policy_files import WORK, load, os, refused, write

new, old = os.path.join(WORK, "a.pt"), os.path.join(WORK, "old.pth")
torch.save(torch.nn.Linear(3, 3).state_dict(), new)
torch.save(torch.nn.Linear(3, 3).state_dict(), old, _use_new_zipfile_serialization=False)
for path in [new, old]:
    refused(["sim", "--policy", path], "PyTorch", "murmurate.export")
    refused(["policy", "check", path], "PyTorch", "docs/bring-your-policy.md")
header, manifest, tensors = load("python_full.safetensors")
refused(["sim", "--policy", write("none.safetensors", header, None, tensors)], "it has no manifest", "'murmurate'")
upper = {**manifest, "sha256": manifest["sha256"].upper()}
refused(["sim", "--policy", write("upper.safetensors", header, upper, tensors)], "sha256", "upper case")
policy = write("policy.safetensors", header, manifest, tensors)
train = ["train", "passage", "--steps", "1", "--out", os.path.join(WORK, "out"), "--from"]
refused([*train, policy], "policy file", "checkpoint.bin")

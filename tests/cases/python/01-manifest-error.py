"""A wrong value in a manifest is refused by the field's path and the value, in words of people."""
import copy

from lib_policy_files import load, refused, write

CASES = [
    ("python_full.safetensors", ["format"], "1", 'format: "1"'),
    ("python_full.safetensors", ["observation"], "position", 'observation: "position"; expected a list'),
    ("conv_gatv2.safetensors", ["observation", 1], "lidar", 'observation.1: "lidar"; expected goal-minus-position'),
    ("conv_gatv2.safetensors", ["action"], "force", 'action: "force"; expected velocity or acceleration'),
    ("conv_gatv2.safetensors", ["hops", 0, "aggregation"], "median", 'hops.0.aggregation: "median"; expected sum'),
    ("conv_gatv2.safetensors", ["hops", 0, "score", "activation"], "sigmoid", 'hops.0.score.activation: "sigmoid"'),
    ("conv_gatv2.safetensors", ["hops", 0, "score", "activation"], "leaky-relu", '{"leaky-relu": NUMBER}'),
    ("conv_gatv2.safetensors", ["hops", 0, "self_loop"], True, "hops.0.self_loop: true; expected zero-edge or mean-edge"),
]
for name, path, value, words in CASES:
    header, manifest, tensors = load(name)
    manifest = copy.deepcopy(manifest)
    table = manifest
    for step in path[:-1]:
        table = table[step]
    table[path[-1]] = value
    refused(["policy", "check", write("changed.safetensors", header, manifest, tensors)], "manifest", words)

#!/usr/bin/env python3
"""Compares messaging peers on the emulated radio of `murmurate lab`, interleaved. One JSON line a run, and a table.

    NETPEERS=/path/to/harness netpeer/lab.py --out rows.jsonl [--peers raw,fdds-uni-rel,ours] [--robots 3,5,10] ...

Every peer is a command by the contract of the harness (NP_ID, NP_RATE, NP_DIR and so on; its README has it all): one
process is one participant. It runs in a station of a lab, so its frames contend for the channel like those of any program.
Peers are those of $NETPEERS/peers.txt, with {B} for $BUILD (default $NETPEERS/.build), and the example `netpeer` as `ours`,
`ours-be` (best effort) and `ours-uni` (unicast), each also with `-data` for messages alone. `fdds-uni-noack` and
`fdds-mc-noack` are the harness's Fast DDS, reliable without positive acknowledgements. `ros-rel`, `ros-be` and
`ros-noack` (each also with `-bare`) are ROS 2, and `zenoh-rel`, `zenoh-drop`, `zenoh-be` and `zenoh-mc` Zenoh, by
participant.py. netpeer/peers.sh installs them.
A name that is no peer's is taken as a command. Needs root and a program with the feature `lab`.

`--places` puts the stations at places: `line:25` and `grid:25` by their spacing [m], or a file with a line `x y` for
each. Then only pairs within the radio's `range_m` count as receivers. A participant says that it is ready when it has
heard all others. Where some are out of range it never is, so `--wait` is the time that all have to find each other.
`--bytes` is the size of a message; `BYTES=12000 netpeer/peers.sh` builds the harness's peers for it, and `ours` has
152 alone. Participants of one rate send at evenly spaced times of the period, so hidden stations never meet. With
`--spread 0.05` their rates go evenly from 5 % less to 5 % more, and so their times pass through each other.

Fields of a row: `delivered`, `in20ms`, `in50ms` are shares of all messages times receivers; `met` is the share of the
pairs in range of which any message arrived, `beyond` counts messages from out of range. `airtime` is the share of the
time of sending in which the stations' frames were on the air, `air_ms_per_msg` that time for each message sent.
`frames_per_msg` counts transmissions with retries. `mesh_s` is the time until every participant has heard every other,
`mesh_airtime` the share of airtime until then. `late` is the share of frames that the lab has written late: with more
than 0.01 the machine was too slow for the case, and its delays are not the channel's."""
import argparse
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)
# Size of a message by the contract of the harness [bytes].
BYTES = 152
# Time that participants in Python have to import their middleware, before they touch the network [s].
PYTHON_STARTS = "2"
now = time.monotonic_ns


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=os.path.join(ROOT, "target/release/murmurate"))
    parser.add_argument("--ours", default=os.path.join(ROOT, "target/release/examples/netpeer"))
    parser.add_argument("--peers", default="raw,fdds-uni-rel,fdds-mc-be,cyc-rel,cyc-be,ours")
    parser.add_argument("--robots", help="numbers of participants; default: 3,5,10, or all places of a file")
    parser.add_argument("--places", default="", help="line:SPACING, grid:SPACING [m], or a file of lines 'x y'")
    parser.add_argument("--bytes", type=int, default=BYTES, help="size of a message")
    parser.add_argument("--rates", help="messages a second of all together; default: --rate for each participant")
    parser.add_argument("--rate", type=float, default=20.0, help="messages a second of each participant")
    parser.add_argument("--spread", type=float, default=0.0, help="of the rates, as a share; see above")
    parser.add_argument("--preset", default="wifi", help="radio of the lab")
    parser.add_argument("--radio", default="", help="fields on top, such as 'noise_loss=0.16,retries=3'")
    parser.add_argument("--retries", help="a sweep of the radio's field of that name, such as 1,3,5,7")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--drain", type=float, default=1.0)
    parser.add_argument("--wait", type=float, default=30.0, help="time for the mesh, at most [s]")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--name", default="npl", help="name of the lab")
    parser.add_argument("--out", default="")
    return parser.parse_args()


def peers(args):
    """Returns variables and command of each peer."""
    harness = os.environ.get("NETPEERS", "")
    build = os.environ.get("BUILD", os.path.join(harness, ".build"))
    sized = build if args.bytes == BYTES else os.path.join(build, f"bytes-{args.bytes}")
    # Ours: multicast that repeats, without repeats, and unicast; `-data` without the heartbeats and modes of robots.
    known = {name + data: (dict(variables, **bare), args.ours)
             for name, variables in [("ours", {}), ("ours-be", {"NP_REPEAT": "0"}),
                                     ("ours-uni", {"NP_VARIANT": "uni", "NP_REPEAT": "0"})]
             for data, bare in [("", {}), ("-data", {"NP_ROBOT": "0"})]}
    for cast in ["uni", "mc"]:
        known[f"fdds-{cast}-noack"] = ({"NP_VARIANT": f"{cast}-rel-nopack"}, f"{sized}/fastdds")
    for kind, variants in [("ros", "rel be noack rel-bare be-bare noack-bare"), ("zenoh", "rel drop be mc")]:
        for variant in variants.split():
            name = f"{kind}-{variant}"
            python = "zenoh-mc" if name == "zenoh-mc" else kind
            known[name] = ({"NP_VARIANT": variant, "NP_LEAD": PYTHON_STARTS, "NP_BYTES": str(args.bytes)},
                           f"{build}/{python}/bin/python {HERE}/participant.py {kind}")
    listed = os.path.join(harness, "peers.txt")
    if harness and os.path.exists(listed):
        with open(listed) as lines:
            for line in lines:
                if line.strip() and not line.startswith("#"):
                    name, variables, command = (part.strip() for part in line.split("|", 2))
                    pairs = dict(pair.split("=", 1) for pair in variables.split())
                    known[name] = (pairs, command.replace("{B}", sized))
    chosen = {name: known.get(name, ({}, name)) for name in args.peers.split(",")}
    for name, (_, command) in chosen.items():
        program = command.split()[0]
        if args.bytes != BYTES and program == args.ours:
            sys.exit(f"{name} has messages of {BYTES} bytes alone: leave --bytes out, or the peer")
        if program.startswith(sized) and not os.path.exists(program):
            sys.exit(f"{name} needs {program}: BYTES={args.bytes} netpeer/peers.sh builds it")
    return chosen


def places(args):
    """Returns the place of each of a number of stations [m], as a function; None without places."""
    kind, _, spacing = args.places.partition(":")
    if not args.places:
        return lambda robots: None
    if kind == "line":
        return lambda robots: [(float(spacing) * at, 0.0) for at in range(robots)]
    if kind == "grid":
        def grid(robots):
            columns = math.ceil(math.sqrt(robots))
            return [(float(spacing) * (at % columns), float(spacing) * (at // columns)) for at in range(robots)]
        return grid
    with open(args.places) as lines:
        listed = [tuple(map(float, line.split())) for line in lines if line.strip()]
    args.robots = args.robots or str(len(listed))
    if max(map(int, args.robots.split(","))) > len(listed):
        sys.exit(f"{args.places} has {len(listed)} places, fewer than --robots {args.robots}")
    return lambda robots: listed[:robots]


class Lab:
    """A laboratory that is up."""

    def __init__(self, args, robots, retries, at):
        self.args, self.robots = args, robots
        fields = dict(pair.split("=", 1) for pair in args.radio.split(",") if pair)
        if retries is not None:
            fields["retries"] = retries
        radio = "".join(f"{key} = {value}\n" for key, value in fields.items())
        self.file = tempfile.NamedTemporaryFile("w", suffix=".toml", delete=False)
        stations = "".join(f"\n[[station]]\nnumber = {number}\nposition_m = [{x}, {y}]\n"
                           for number, (x, y) in enumerate(at or []))
        head = f'name = "{args.name}"\nstations = {robots}\npreset = "{args.preset}"\n'
        self.file.write(f"{head}\n[radio]\n{radio}{stations}")
        self.file.close()
        range_m = float(fields.get("range_m", "inf"))

        def hear(own, other):
            return own != other and (not at or math.dist(at[own], at[other]) <= range_m)
        # The stations that each one can hear.
        self.hears = [{other for other in range(robots) if hear(own, other)} for own in range(robots)]

    def __enter__(self):
        subprocess.run([self.args.program, "lab", "up", self.file.name], check=True, stderr=subprocess.PIPE)
        return self

    def __exit__(self, *_):
        subprocess.run([self.args.program, "lab", "down", "--name", self.args.name], stderr=subprocess.PIPE)
        os.unlink(self.file.name)

    def counters(self):
        text = subprocess.run([self.args.program, "lab", "status", "--json", "--name", self.args.name],
                              check=True, stdout=subprocess.PIPE).stdout
        return json.loads(text)


def sleep_until(ns):
    if ns > now():
        time.sleep((ns - now()) / 1e9)


def between(before, after):
    """Returns what the channel did between two looks at the counters."""
    radio = {key: after["radio"][key] - before["radio"][key] for key in ("transmissions", "airtime_ns", "channel_ns")}
    lateness = [after["lateness"][key] - before["lateness"][key] for key in ("late", "deliveries")]
    lost = {key: after["radio"][key] - before["radio"][key] for key in
            ("lost_queue", "lost_retries", "lost_collision", "lost_noise", "lost_range")}
    return radio, lateness, {key: count for key, count in lost.items() if count}


def measure(args, lab, peer, variables, command, rate):
    """Runs one peer once, and returns the row of its result."""
    robots, folder = lab.robots, tempfile.mkdtemp(prefix="np.")
    start = now() + int((0.25 + 0.02 * robots + float(variables.get("NP_LEAD", 0))) * 1e9)
    about = lab.counters()
    stations = about["stations"]
    hello_ms = 100 if robots <= 5 else 200 if robots <= 10 else 500
    if args.bytes != BYTES and rate > 0:
        # Large hellos come no more often than messages.
        hello_ms = max(hello_ms, int(1000 * robots / rate))
    environment = dict(os.environ, NP_N=str(robots), NP_SECONDS=str(args.seconds),
                       NP_DRAIN=str(args.drain), NP_IFACE=about["interface"], NP_DIR=folder, NP_START_NS=str(start),
                       NP_HELLO_MS=str(hello_ms),
                       NP_PEERS=",".join(station["address"] for station in stations), **variables)
    processes = []
    for station in stations:
        number = station["station"]
        spread = 1 + args.spread * (2 * number / max(1, robots - 1) - 1)
        own = dict(environment, NP_ID=str(number), NP_ADDR=station["address"], NP_RATE=str(rate / robots * spread))
        log = open(os.path.join(folder, f"log.{station['station']}"), "w")
        words = ["nice", "-n", os.environ.get("NP_NICE", "-15"), "ip", "netns", "exec", station["namespace"],
                 "sh", "-c", "exec " + command]
        processes.append(subprocess.Popen(words, env=own, cwd=folder, stdout=log, stderr=log, start_new_session=True))
    try:
        sleep_until(start - 20_000_000)
        quiet = lab.counters()
        while now() < start + args.wait * 1e9:
            ready = sum(os.path.exists(os.path.join(folder, f"ready.{at}")) for at in range(robots))
            if ready == robots or any(process.poll() is not None for process in processes):
                break
            time.sleep(0.01)
        met = lab.counters()
        window = now() + int(0.5e9)
        with open(os.path.join(folder, ".go"), "w") as go:
            go.write(f"{window}\n")
        os.rename(os.path.join(folder, ".go"), os.path.join(folder, "go"))
        sleep_until(window - 20_000_000)
        before = lab.counters()
        sleep_until(window + int(args.seconds * 1e9))
        busy = lab.counters()
        sleep_until(window + int((args.seconds + args.drain - 0.05) * 1e9))
        after = lab.counters()
        end = time.monotonic() + 8
        for process in processes:
            try:
                process.wait(max(0.1, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                pass
    finally:
        for process in processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    row = result(args, folder, start, lab.hears)
    row.update(places=args.places, bytes=args.bytes, spread=args.spread)
    row.update(peer=peer, n=robots, rate=rate, preset=args.preset, radio=args.radio, seconds=args.seconds)
    radio, (late, deliveries), lost = between(before, after)
    sending, _, _ = between(before, busy)
    discovery, _, _ = between(quiet, met)
    row.update(airtime=sending["airtime_ns"] / max(1, sending["channel_ns"]),
               air_ms_per_msg=radio["airtime_ns"] / 1e6 / max(1, row["sent"]),
               frames_per_msg=radio["transmissions"] / max(1, row["sent"]), lost=lost,
               mesh_airtime=discovery["airtime_ns"] / max(1, discovery["channel_ns"]),
               late=late / max(1, deliveries))
    if row["reports"] < robots:
        with open(os.path.join(folder, "log.0")) as log:
            row["log"] = log.read()[-300:]
    shutil.rmtree(folder, ignore_errors=True)
    return row


def result(args, folder, start, hears):
    """Reads what the participants have written; `hears` has the stations that each one can hear."""
    row = dict(sent=0, failed=0, delivered=0.0, reports=0, duplicates=0, beyond=0)
    mesh, delays, unique, cpu, robots, met, sent = [], {}, 0, 0.0, len(hears), set(), [0] * len(hears)
    for at in range(robots):
        path = os.path.join(folder, f"out.{at}")
        if not os.path.exists(path):
            continue
        with open(path) as lines:
            for words in map(str.split, lines):
                kind = words[0]
                if kind == "mesh":
                    mesh.append(int(words[1]))
                elif kind == "sent":
                    sent[at] = int(words[1])
                    row["failed"] += int(words[2])
                elif kind == "cpu":
                    cpu += float(words[1]) + float(words[2])
                elif kind == "from":
                    count, near = int(words[2]), int(words[1]) in hears[at]
                    unique += count if near else 0
                    row["beyond"] += 0 if near else count
                    met.update({(at, int(words[1]))} if near and count else set())
                    row["duplicates"] += int(words[3])
                elif kind == "h":
                    delays[int(words[1])] = delays.get(int(words[1]), 0) + int(words[2])
                elif kind == "end":
                    row["reports"] += 1
                elif len(words) == 4 and kind.isdigit():
                    if int(words[1]) not in hears[at]:
                        row["beyond"] += 1
                        continue
                    unique += 1
                    met.add((at, int(words[1])))
                    delays[int(words[3])] = delays.get(int(words[3]), 0) + 1
    row["sent"] = sum(sent)
    wanted = sum(sent[other] for own in hears for other in own)
    total = sum(delays.values())

    def within(ms):
        return sum(count for delay, count in delays.items() if delay <= ms * 1e6) / wanted if wanted else None

    def quantile(share):
        seen = 0
        for delay, count in sorted(delays.items()):
            seen += count
            if seen >= share * total:
                return delay / 1e6
        return None

    row.update(delivered=unique / wanted if wanted else None, in20ms=within(20), in50ms=within(50),
               p50_ms=quantile(0.5), p90_ms=quantile(0.9), p99_ms=quantile(0.99),
               mesh_s=(max(mesh) - start) / 1e9 if len(mesh) == robots and all(mesh) else None,
               met=len(met) / max(1, sum(map(len, hears))),
               cpu_ms_per_s=1e3 * cpu / (args.seconds + args.drain))
    return row


def median(values):
    values = sorted(value for value in values if value is not None)
    return values[len(values) // 2] if values else float("nan")


def table(rows):
    """Prints the medians of each case."""
    fields = [("deliv %", "delivered", 100, 1), ("20ms %", "in20ms", 100, 1), ("50ms %", "in50ms", 100, 1),
              ("p50 ms", "p50_ms", 1, 2), ("p90 ms", "p90_ms", 1, 1), ("air %", "airtime", 100, 2),
              ("frames", "frames_per_msg", 1, 2), ("mesh s", "mesh_s", 1, 2), ("mesh air %", "mesh_airtime", 100, 2),
              ("met %", "met", 100, 0), ("cpu ms/s", "cpu_ms_per_s", 1, 0), ("late %", "late", 100, 2)]
    print(f"{'n':>3} {'msg/s':>6} {'retries':>7} {'peer':16}" + "".join(f"{title:>11}" for title, *_ in fields))
    cases = {}
    for row in rows:
        cases.setdefault((row["n"], row["rate"], row["retries"], row["peer"]), []).append(row)
    for (robots, rate, retries, peer), runs in cases.items():
        shown = "".join(f"{scale * median([run.get(key) for run in runs]):11.{digits}f}" for _, key, scale, digits in fields)
        whole = all(run["reports"] == robots for run in runs)
        name = peer.rsplit("/", 1)[-1][:16]
        print(f"{robots:3} {rate:6.0f} {retries or '':>7} {name:16}{shown}{'' if whole else '  not all have reported'}")


def main():
    args = arguments()
    if os.geteuid() != 0:
        sys.exit("network namespaces need root")
    chosen, place, rows = peers(args), places(args), []
    out = open(args.out, "a") if args.out else None
    for _ in range(args.rounds):
        for robots in map(int, (args.robots or "3,5,10").split(",")):
            for retries in args.retries.split(",") if args.retries else [None]:
                with Lab(args, robots, retries, place(robots)) as lab:
                    rates = map(float, args.rates.split(",")) if args.rates else [args.rate * robots]
                    for rate in rates:
                        for name, (variables, command) in chosen.items():
                            row = measure(args, lab, name, variables, command, rate)
                            row["retries"] = retries
                            rows.append(row)
                            if out:
                                print(json.dumps(row), file=out, flush=True)
    table(rows)


main()

"""Kills a server at random points of everything it does, and holds it to what it acknowledged.

    python heavy/kill.py [--rounds N] [--seed S] [--workers W] [--config FILE] [--old-binary FILE]
        [--backup 'percept store backup --data-dir {data} {to}']

Workers create, fill, ask, list and delete sessions of their own over gRPC and REST, under deadlines from
half a millisecond up, and leave in the middle. After random times the server is killed (one in five times:
asked to stop) and started on the same data. Each worker keeps a model of what may be true of its sessions;
what the server then says is compared with it. Nothing acknowledged may be lost, nothing deleted may come
back, no session may be stuck.

With `--old-binary` an earlier version runs the first third of the rounds, with callers that stay. With
`--backup` that command runs in each round, the kill notwithstanding; what it has finished is opened by a
server of its own and must hold nothing that was not sent. Exits with 1 if anything was violated.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import pathlib
import random
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field

import grpc
import httpx

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

from percept.v1 import sensor_pb2

from support import raw, robots, world
from support.server import Server, binary

SESSIONS, SENSORS = "SessionsService", "SensorsService"
ABSENT = ""
#: A call that takes longer while nobody hurries it is stuck, seconds.
STUCK_S = 30.0
UNDECIDED = ("DEADLINE_EXCEEDED", "CANCELLED", "UNAVAILABLE", "ABORTED", "UNKNOWN", "INTERNAL")


@dataclass
class Name:
    """What may be true of one session id."""

    session_id: str
    #: Lives that it may be in, by display name; ABSENT: it may not exist.
    possible: set[str] = field(default_factory=lambda: {ABSENT})
    #: Stamps by life: acknowledged as durable, and sent at all.
    acknowledged: dict[str, set[int]] = field(default_factory=dict)
    sent: dict[str, set[int]] = field(default_factory=dict)
    #: Frames whose senders left: they may still arrive, in a later life, too.
    unheard: set[int] = field(default_factory=set)
    lives: int = 0
    next_frame: int = 0


class Worker:
    """Does things to its own sessions until the server is gone; remembers what it was told."""

    def __init__(self, number: int, seed: int, count: int) -> None:
        self.impatience = 0.0
        self.rng = random.Random(f"{seed}/{number}")
        self.names = [Name(f"w{number}-{k}") for k in range(count)]
        self.tally: Counter[str] = Counter()
        self.violations: list[str] = []

    def run(self, server: Server, stop: threading.Event) -> None:
        self.gone = False
        with contextlib.suppress(OSError, grpc.FutureTimeoutError), raw.Calls(server.grpc) as self.calls:
            while not stop.is_set() and not self.gone:
                self.step(server)

    def step(self, server: Server) -> None:
        name = self.rng.choice(self.names)
        acts = [
            self.create,
            self.delete,
            self.frame,
            self.frame,
            self.frame,
            self.stream,
            self.ask,
            self.rest_delete,
        ]
        act = self.rng.choice(acts if name.possible != {ABSENT} else [self.create])
        act(name, server)

    def violated(self, name: Name, what: str) -> None:
        self.violations.append(f"{name.session_id}: {what}; possible were {sorted(name.possible)}")

    def patience(self) -> float:
        """Some calls are given up early."""
        return STUCK_S if self.rng.random() >= self.impatience else 10 ** self.rng.uniform(-3.3, -1.3)

    def count(self, what: str, answer: raw.Answer, patience: float) -> None:
        self.tally[f"{what} {answer.code}"] += 1
        # Without a reason it is not percept that answered: nobody is there.
        self.gone = self.gone or (answer.code == "UNAVAILABLE" and not answer.reason)
        if answer.code == "DEADLINE_EXCEEDED" and patience >= STUCK_S:
            self.violations.append(f"{what}: no answer for {STUCK_S:.0f} s")

    def create(self, name: Name, _: Server) -> None:
        name.lives += 1
        life = f"life{name.lives}"
        name.acknowledged[life], name.sent[life] = set(), set(name.unheard)
        sensors = [sensor_pb2.SensorSpec(sensor_id="laser", kind=sensor_pb2.SENSOR_KIND_LIDAR2D)]
        fields = {"session_id": name.session_id, "display_name": life, "sensors": sensors}
        patience = self.patience()
        answer = self.calls(f"{SESSIONS}/CreateSession", patience, request_id=f"{name.session_id}/{life}", **fields)
        self.count("create", answer, patience)
        if answer.ok:
            if ABSENT not in name.possible:
                self.violated(name, f"created as {life} though it exists")
            name.possible = {life}
            session = answer.message.session
            if session.num_keyframes or session.display_name != life or session.HasField("pose"):
                seen = f"{session.num_keyframes} keyframes, named {session.display_name!r}"
                self.violated(name, f"the new session {life} is not empty: {seen}")
        elif answer.code == "ALREADY_EXISTS":
            name.possible.discard(ABSENT)
            if not name.possible:
                name.possible = {ABSENT}
                self.violated(name, "it exists, though it was deleted or never made")
        elif answer.code in UNDECIDED:
            if ABSENT in name.possible:
                name.possible.add(life)
                self.settle(name)
        else:
            self.violated(name, f"create answered {answer}")

    def delete(self, name: Name, _: Server) -> None:
        patience = self.patience()
        answer = self.calls(f"{SESSIONS}/DeleteSession", patience, session_id=name.session_id)
        self.count("delete", answer, patience)
        if answer.ok:
            name.possible = {ABSENT}
        elif answer.code == "NOT_FOUND":
            self.absent(name)
        elif answer.code in UNDECIDED:
            name.possible.add(ABSENT)
            self.settle(name)
        else:
            self.violated(name, f"delete answered {answer}")

    def rest_delete(self, name: Name, server: Server) -> None:
        if self.rng.random() >= self.impatience:
            return
        name.possible.add(ABSENT)
        self.tally["delete, left at once"] += 1
        raw.send_and_leave(server.rest, raw.request_head("DELETE", f"/v1/sessions/{name.session_id}"))
        self.settle(name)

    def absent(self, name: Name) -> None:
        if ABSENT not in name.possible:
            self.violated(name, "lost: it is not found")
        name.possible = {ABSENT}

    def frame(self, name: Name, _: Server) -> None:
        index, patience = self.index(name), self.patience()
        message = robots.scan_message(name.session_id, index)
        answer = self.calls(f"{SENSORS}/SendFrame", patience, message=message)
        self.count("frame", answer, patience)
        if answer.ok:
            self.took(name, index)
        elif answer.code == "NOT_FOUND":
            self.absent(name)
        elif answer.code in UNDECIDED:
            name.unheard.add(world.stamp(index))
        elif answer.reason != "STAMP_NOT_INCREASING":
            self.violated(name, f"frame answered {answer}")

    def stream(self, name: Name, _: Server) -> None:
        """Several frames under way at once, then perhaps gone before they are answered."""
        sent = []
        for _ in range(self.rng.randint(2, 6)):
            index = self.index(name)
            call = self.calls.begin(
                f"{SENSORS}/SendFrame", STUCK_S, message=robots.scan_message(name.session_id, index)
            )
            sent.append((index, call))
        leave = self.rng.random() < self.impatience
        for index, call in sent:
            if leave and self.rng.random() < 0.5:
                call.cancel()
            answer = raw.answer_of(call)
            self.count("frames at once", answer, 0)
            if answer.ok:
                self.took(name, index)
            elif answer.code == "NOT_FOUND":
                self.absent(name)
            else:
                name.unheard.add(world.stamp(index))

    def index(self, name: Name) -> int:
        index, name.next_frame = name.next_frame, name.next_frame + 1
        for life in name.possible - {ABSENT}:
            name.sent[life].add(world.stamp(index))
        return index

    def took(self, name: Name, index: int) -> None:
        lives = name.possible - {ABSENT}
        if not lives:
            self.violated(name, "a frame was taken though it does not exist")
        elif len(lives) == 1:
            name.acknowledged[next(iter(lives))].add(world.stamp(index))
            name.possible = lives

    def ask(self, name: Name, _: Server) -> None:
        patience = self.patience()
        answer = self.calls(f"{SESSIONS}/GetPose", patience, session_id=name.session_id)
        self.count("pose", answer, patience)
        if answer.code == "NOT_FOUND":
            self.absent(name)

    def settle(self, name: Name) -> None:
        """What was begun behind a caller's back ends soon; asks until the answer stays."""
        seen, alike = None, 0
        while alike < 15:
            answer = self.calls(f"{SESSIONS}/GetSession", STUCK_S, session_id=name.session_id)
            if answer.code == "UNAVAILABLE" and not answer.reason:
                return
            life = answer.message.session.display_name if answer.ok else answer.code
            seen, alike = life, alike + 1 if life == seen else 0
            time.sleep(0.005)
        if seen == "NOT_FOUND":
            self.absent(name)
        elif seen in name.possible:
            name.possible = {seen}
        elif seen not in UNDECIDED:
            self.violated(name, f"it is {seen}, which cannot be")

    def verify(self, server: Server, shown: dict[str, dict]) -> None:
        """After a restart: what is there must be what may be there."""
        with raw.Calls(server.grpc) as calls, httpx.Client(base_url=server.rest_url, timeout=STUCK_S) as http:
            for name in self.names:
                name.unheard.clear()
                answer = calls(f"{SESSIONS}/GetSession", STUCK_S, session_id=name.session_id)
                if (name.session_id in shown) != (answer.code != "NOT_FOUND"):
                    self.violated(name, f"the list and the session itself disagree: {answer.code}")
                if answer.code == "NOT_FOUND":
                    self.absent(name)
                    continue
                if not answer.ok:
                    self.violated(name, f"stuck: {answer}")
                    continue
                life = answer.message.session.display_name
                if life not in name.possible:
                    self.violated(name, f"back from the dead: it is {life}")
                    name.acknowledged[life] = set()
                trajectory = http.get(f"/v1/sessions/{name.session_id}/trajectory")
                if trajectory.status_code != 200:
                    self.violated(name, f"stuck: {trajectory.text[:200]}")
                    continue
                stamps = {int(p["stamp_ns"]) for p in trajectory.json().get("poses", [])}
                lost = name.acknowledged.get(life, set()) - stamps
                if lost:
                    self.violated(name, f"{len(lost)} acknowledged frames of {life} are lost")
                alien = stamps - name.sent.get(life, set())
                if alien:
                    self.violated(name, f"{len(alien)} frames of another life are in {life}")
                name.possible = {life}

    def acknowledged(self) -> int:
        return sum(len(a) for n in self.names for a in n.acknowledged.values())


def listed(server: Server) -> dict[str, dict]:
    """All sessions as the list shows them."""
    out, token = {}, ""
    with httpx.Client(base_url=server.rest_url, timeout=STUCK_S) as http:
        while True:
            page = http.get("/v1/sessions", params={"page_size": 1000, "page_token": token}).json()
            out |= {s["session_id"]: s for s in page.get("sessions", [])}
            token = page.get("next_page_token", "")
            if not token:
                return out


class Rounds:
    """Kills and restarts one server under its workers."""

    def __init__(self, arguments, folder: pathlib.Path) -> None:
        self.arguments, self.folder = arguments, folder
        self.rng = random.Random(arguments.seed)
        self.binary = str(binary())
        self.workers = [Worker(k, arguments.seed, arguments.names) for k in range(arguments.workers)]
        self.starts_s: list[float] = []
        self.bad_exits: list[int] = []
        self.backups: Counter[str] = Counter()
        self.violations: list[str] = []
        self.choose_binary(0)
        extra = ("--config", arguments.config) if arguments.config else ()
        self.server = Server(folder / "data", *extra)

    def choose_binary(self, round_: int) -> None:
        """The earlier version for the first third of the rounds, if there is one."""
        old = self.arguments.old_binary if round_ < self.arguments.rounds // 3 else None
        os.environ["PERCEPT_BIN"] = old or self.binary
        for worker in self.workers:
            worker.impatience = 0.0 if old else self.arguments.impatience

    def round(self, number: int) -> None:
        server, stop = self.server, threading.Event()
        threads = [threading.Thread(target=w.run, args=(server, stop)) for w in self.workers]
        for thread in threads:
            thread.start()
        time.sleep(self.rng.uniform(0.1, self.arguments.longest_s))
        backup = self.begin_backup(number)
        time.sleep(self.rng.uniform(0.1, 0.5))
        if self.rng.random() < 0.2:
            code = server.stop()
            if code != 0:
                self.bad_exits.append(code)
        else:
            server.kill()
        stop.set()
        for thread in threads:
            thread.join()
        if backup:
            self.check_backup(*backup)
        self.choose_binary(number + 1)
        begin = time.perf_counter()
        server.start()
        self.starts_s.append(time.perf_counter() - begin)
        shown = listed(server)
        for worker in self.workers:
            worker.verify(server, shown)

    def begin_backup(self, number: int):
        if not self.arguments.backup:
            return None
        to = self.folder / f"backup{number}"
        named = {"data": self.folder / "data", "to": to, "rest": self.server.rest, "grpc": self.server.grpc}
        words = [w.format(**named) for w in shlex.split(self.arguments.backup)]
        words[0] = self.binary if words[0] == "percept" else words[0]
        return to, subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def check_backup(self, to: pathlib.Path, process: subprocess.Popen) -> None:
        """What a backup that ended well holds must open, and hold nothing that was not sent."""
        error = process.communicate()[1]
        self.backups["done" if process.returncode == 0 else f"failed: {error.strip()[-100:]}"] += 1
        if process.returncode != 0:
            return
        server = Server(to)
        names = {n.session_id: n for w in self.workers for n in w.names}
        with httpx.Client(base_url=server.rest_url, timeout=STUCK_S) as http:
            for session_id, session in listed(server).items():
                answer = http.get(f"/v1/sessions/{session_id}/trajectory")
                stamps = {int(p["stamp_ns"]) for p in answer.json().get("poses", [])}
                sent = names[session_id].sent.get(session["display_name"], set())
                if answer.status_code != 200 or stamps - sent:
                    self.violations.append(f"backup of {session_id}: {answer.status_code} {stamps - sent}")
        server.stop()
        shutil.rmtree(to, ignore_errors=True)

    def report(self) -> dict:
        tally = sum((w.tally for w in self.workers), Counter())
        return {
            "rounds": self.arguments.rounds,
            "calls": dict(sorted(tally.items())),
            "frames_acknowledged": sum(w.acknowledged() for w in self.workers),
            "backups": dict(self.backups),
            "start_s": {
                "mean": round(sum(self.starts_s) / len(self.starts_s), 3),
                "max": round(max(self.starts_s), 3),
            },
            "exit_codes_of_stops_that_failed": self.bad_exits,
            "violations": len(self.all_violations()),
        }

    def all_violations(self) -> list[str]:
        return self.violations + [v for w in self.workers for v in w.violations]


def main() -> int:
    raw_text = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw_text)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--names", type=int, default=4, help="ids of each worker, used again and again")
    parser.add_argument("--impatience", type=float, default=0.5, help="share of callers that leave early")
    parser.add_argument("--longest-s", type=float, default=2.0, help="longest time between kills")
    parser.add_argument("--config", help="configuration file, for example with a short time to sleep")
    parser.add_argument("--old-binary", help="an earlier version, for the first third of the rounds")
    parser.add_argument("--backup", help="command that makes a backup; {data}, {to}, {grpc}, {rest} are set")
    arguments = parser.parse_args()
    for i in range(40):
        robots.scan(i)
    with tempfile.TemporaryDirectory() as folder:
        rounds = Rounds(arguments, pathlib.Path(folder))
        try:
            for number in range(arguments.rounds):
                rounds.round(number)
                calls = sum(sum(w.tally.values()) for w in rounds.workers)
                found = len(rounds.all_violations())
                print(f"round {number + 1}: {calls} calls so far, {found} violations", file=sys.stderr)
            code = rounds.server.stop()
            rounds.bad_exits += [code] if code else []
        finally:
            rounds.server.kill()
        print(json.dumps(rounds.report(), indent=2))
        for violation in rounds.all_violations()[:40]:
            print(violation)
        return 1 if rounds.all_violations() else 0


if __name__ == "__main__":
    sys.exit(main())

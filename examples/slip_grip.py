"""Hold an object that gets heavier, without a drop and without crushing it: an example of using
`contact_slip`.

    python examples/slip_grip.py                # the simulation: fixed grip against slip margin
    python examples/slip_grip.py --loads        # loads that come and go, and slow grippers: minutes
    python examples/slip_grip.py --node --ros-args -r __ns:=/finger

The node answers every `contact_slip` with the force to grip with, on `grip_force`
(std_msgs/Float64, N). Each setting of `SlipGrip`, the controller itself, is a parameter of the
node. While no `contact_slip` comes, it holds harder. The controller uses no ROS and needs no
camera.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from node_parameters import check_numbers, from_parameters, parse_arguments

from finger_common.entry import EXIT_INTERRUPTED
from finger_common.flags import SlipFlag

GRAVITY = 9.81
SAFE = 0.15
"""Share of the normal force that any skin carries sideways."""

LET_GO = 0.5
"""s of states without a known slip after which an object counts as let go."""

LEAST = 1e-3
"""N; no force is compared with less."""

EMPTY = 0.1
"""N; a force below it, either way, is that of an empty grip."""

RELEASED = 0.2
"""Share of the commanded force below which a contact ends that is let go. A force that is gone from
one sample to the next is that of another zero: the object is still held."""

STALE_AFTER = 0.1
"""s without a contact_slip after which the grip answers that none comes."""

SETTLED = 1.0
"""s without such a silence after which contact_slip counts as coming again."""

FOLLOWING, AMISS = 1.0, 0.1
"""s over which the measured force is averaged over the commanded one, and the share by which it may
differ: less than the margin."""

ENOUGH = 0.9
"""Share of `largest` below which the load needs no more than that again."""


@dataclass
class SlipGrip:
    """Normal force that keeps a part of the friction unused.

    margin: slip margin to hold; alarm: slip probability at which it grips harder at once, `reflex`
    times as hard, and again after `patience` (s) if that was not enough; smallest, largest: force
    (N); rise, fall: of the force (N/s); cautious: standard deviations by which friction is taken
    lower than estimated. keep: share of the force for the largest load that stays when the load
    falls, as of an object that is set down and will be lifted again; it fades with the time
    constant `memory` (s), and ends when the object is let go.

    As long as no slip was seen the friction is a guess. The force then falls slowly until a slip
    begins, which tells it, and steps up and down by the share `dither`, `dither_rate` times a
    second. Load over force grows beyond what was held before by no more than `explore` (1/s), so
    that this slip is slow even where the load grows fast. A gripper with a dead time of more than
    50 ms answers that slip too late: it takes dither 0 and unsure 1, the deviations by which a
    guess is taken lower.

    `force` is the force to grip with (N); it begins with the first one measured (NaN), for an
    object that is held already. Once an object was let go it is the one given here again, or else
    `smallest`, so that no large force waits for the next touch. `needed` is what the load may need
    (N), `short` tells whether that is more than `largest`, `follows` is the mean measured force
    over `force`. Raises ValueError for settings that cannot be.
    """

    margin: float = 0.2
    alarm: float = 0.15
    smallest: float = 0.3
    largest: float = 10.0
    rise: float = 40.0
    fall: float = 0.4
    cautious: float = 2.0
    unsure: float = 0.0
    reflex: float = 1.6
    patience: float = 0.15
    keep: float = 0.6
    memory: float = 20.0
    explore: float = 0.4
    dither: float = 0.1
    dither_rate: float = 12.0
    largest_step: float = 0.02
    force: float = math.nan
    needed: float = field(default=0.0, init=False)
    short: bool = field(default=False, init=False)
    follows: float = field(default=1.0, init=False)
    _stamp: float = field(default=-math.inf, init=False)
    _alarmed: float = field(default=-math.inf, init=False)
    _reflex: float = field(default=0.0, init=False)
    _known: float = field(default=-math.inf, init=False)
    _open_since: float = field(default=math.inf, init=False)
    _released: bool = field(default=False, init=False)
    _kept: float = field(default=0.0, init=False)
    _tried: float = field(default=SAFE, init=False)
    _ratio: float = field(default=SAFE, init=False)
    _base: tuple[float, float] | None = field(default=None, init=False)
    _unseen: float = field(default=0.0, init=False)
    _seen: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        check_numbers(self, free=("force", "margin"))
        if not 0.0 <= self.margin < 1.0:
            raise ValueError(f"margin is {self.margin:g}, a number from 0 to below 1 is needed")
        if self.smallest > self.largest:
            raise ValueError(f"smallest, {self.smallest:g}, is above largest, {self.largest:g}")
        self._first = self.smallest if math.isnan(self.force) else self.force
        self._seen = self.force

    def on_slip(
        self,
        stamp: float,
        normal: float,
        slip_margin: float,
        friction: float,
        friction_sd: float,
        probability: float,
        flags: int,
        margin_sd: float = 0.0,
    ) -> float:
        """Force to grip with (N) after a ContactSlip.

        stamp: of its header (s); normal: P (N); slip_margin: which knows the zero of the lateral
        force, as `tangential_force` does not; margin_sd: its standard deviation; friction with its
        standard deviation; flags: bits of SlipFlag. A margin or a probability that is not known
        (NaN) keeps the force. Where anything may be the margin (margin_sd 1, as in a contact in
        which the driver or the model node began anew), what the load grows by is held in the ratio
        that held before, and the force does not fall.
        """
        before, self._stamp = self._stamp, stamp
        if stamp < before:
            # The clock went back.
            self._alarmed, self._known = -math.inf, min(self._known, stamp)
            self._open_since = math.inf
        elapsed = min(max(stamp - before, 0.0), self.largest_step)
        if flags & SlipFlag.FORCE_INVALID or math.isnan(probability + slip_margin):
            empty = flags & SlipFlag.NO_CONTACT and abs(normal) < EMPTY
            self._open_since = min(self._open_since, stamp) if empty else math.inf
            if self._released and stamp - self._open_since > LET_GO:
                self.force, self._unseen = self._first, 0.0
                self.follows = 1.0
            return self.force
        self._open_since = math.inf
        if math.isnan(self.force):
            self.force = self._seen = min(max(normal, self.smallest), self.largest)
        if before - self._known > LET_GO:
            self._kept, self._tried, self._ratio = 0.0, SAFE, SAFE
        self._known = stamp
        guess, doubted = bool(flags & SlipFlag.FRICTION_ASSUMED), margin_sd >= 1.0
        self._released = not doubted and normal < RELEASED * self.force
        if not doubted:
            self.follows += (normal / max(self.force, LEAST) - self.follows) * elapsed / FOLLOWING
        # |Q|: the margin is the mean over all frictions that may be, whose spread makes it smaller.
        spread = 1.0 + (friction_sd / friction) ** 2
        load = (1.0 - slip_margin) * friction * normal / spread
        cautious = self.unsure if guess else self.cautious
        friction = max(friction - cautious * friction_sd, 0.05)
        wanted = load / ((1.0 - self.margin) * friction)
        if doubted:
            self._base = self._base or (self.force, load)
            wanted = self._base[0] + (load - self._base[1]) / self._ratio
        else:
            # After a silence: back to the ratio that held before.
            self.force = min(self.force, max(self._seen, load / self._ratio))
            self._base, self._ratio = None, max(load / max(self.force, LEAST), SAFE)
        if guess and not doubted:
            if load > 0.9 * self._tried * normal:
                self._tried *= 1.0 + self.explore * elapsed
            wanted = max(wanted, load / self._tried)
        self._kept *= math.exp(-elapsed / self.memory)
        self._kept = max(self._kept, self.keep * min(wanted, self.largest))
        self.needed = wanted = max(wanted, self._kept)
        self.short = wanted > (ENOUGH if self.short else 1.0) * self.largest
        self._unseen = min(self.reflex * wanted, self.largest)
        if flags & SlipFlag.SLIPPING or probability > (0.4 if guess else self.alarm):
            if stamp - self._alarmed > self.patience:
                self._alarmed, self._reflex = stamp, self.reflex * normal
            wanted = max(wanted, self._reflex)
        wanted = min(max(wanted, self.smallest), self.largest)
        fall = 0.0 if doubted else self.fall if guess else 4.0 * self.fall
        change = min(max(wanted - self.force, -fall * elapsed), self.rise * elapsed)
        self.force += change
        self._seen = self.force
        # In slip the tangential force follows the grip, in a hold it does not: asking tells which.
        up = (stamp * self.dither_rate) % 1.0 < 0.5
        down = 0.0 if doubted or self.short else -self.dither
        ask = (self.dither if up else down) if guess else 0.0
        return min(max(self.force * (1.0 + ask), self.smallest), self.largest)

    def on_silence(self) -> float:
        """Force to grip with (N) while no ContactSlip has come for STALE_AFTER: `reflex` times what
        the last load needs, as it may grow unseen, until the next one comes."""
        self.force = max(self.force, self._unseen)
        return self.force


@dataclass(frozen=True)
class Outcome:
    """Of a simulated hold: whether it was dropped, how far it slid (m), mean force over the least
    that holds it, in the last second."""

    dropped: bool
    slid: float
    force_ratio: float


def hold(
    controller: SlipGrip | None,
    friction: float,
    seed: int = 0,
    fixed: float = 2.0,
    zero: float = 0.0,
    grip_follows_load: bool = False,
    delay: float = 0.0,
    sensor: Callable[[float, list[float]], list[float]] | None = None,
    lifted: Callable[[float], float] = lambda time: 1.0,
    silent: tuple[float, float] = (0.0, 0.0),
    rate: float = 500.0,
) -> Outcome:
    """Two fingers take an object of 50 g, which is filled to 350 g between 2 and 8 s.

    controller: None for a grip with the fixed force (N), with which each begins; friction: of skin
    on the object, which the controller does not know. zero: what the sensor gives along the load in
    the air (N). grip_follows_load: the estimator's setting. The gripper is open for 0.7 s and
    closes 0.3 s before the controller begins. It follows its command within 30 ms, after a dead
    time of delay (s). The force has 5 mN of noise; sensor: what it gives of a force (3,) in N at a
    time (s). lifted: share of the weight that the fingers carry at a time (s): 0 where a table
    does, above 1 where the object is accelerated upwards. silent: from when until when (s) the
    sensor gives nothing; rate: of its samples (Hz, 500 or a whole part of it). A slide of 20 mm is
    a drop.
    """
    from finger_model.estimator import ContactEstimator
    from finger_model.finger import load_reduced
    from finger_model.slip import SlipEstimator, SlipSettings

    rng = np.random.default_rng(seed)
    contact = ContactEstimator(load_reduced())
    settings = SlipSettings(tangential_noise=0.005, grip_follows_load=grip_follows_load)
    slip = SlipEstimator(settings)
    step = 0.002
    force = speed = slid = 0.0
    command = fixed
    commands = deque([fixed] * round(delay / step))
    ratios, heard_at = [], 0.0
    for i in range(int(11.0 / step)):
        time = i * step - 1.0
        mass = float(np.interp(time, [0.5, 1.0, 2.0, 8.0], [1e-3, 0.05, 0.05, 0.35]))
        commands.append(command if time > -0.3 else 0.0)
        force += (commands.popleft() - force) * step / 0.03
        load = mass * GRAVITY / 2.0 * lifted(time) if time > 0.0 else 0.0
        most = friction * force
        sliding = load > most or speed > 0.0
        carried = most if sliding else load
        speed = max(0.0, speed + 2.0 * (load - carried) / mass * step) if sliding else 0.0
        slid += speed * step
        if slid > 0.02:
            return Outcome(True, slid, math.nan)
        noise = rng.normal(0.0, 0.005, 3)
        wrench = [carried + zero + noise[0], noise[1], -(force + noise[2])]
        if sensor is not None:
            wrench = sensor(time, wrench)
        heard = not silent[0] <= time < silent[1] and i % round(500.0 / rate) == 0
        for estimate in contact.add_wrench(i * 2_000_000, wrench) if heard else ():
            found = slip.add(estimate, wrench)
            if controller is not None and time > 0.0:
                command = controller.on_slip(
                    time,
                    found.normal_force,
                    found.slip_margin,
                    found.friction,
                    found.friction_stddev,
                    found.slip_probability,
                    found.flags,
                    found.slip_margin_stddev,
                )
                heard_at = time
        if controller is not None and time > heard_at + STALE_AFTER:
            command = controller.on_silence()
        if time > 9.0:
            ratios.append(force * friction / load)
    return Outcome(False, slid, float(np.mean(ratios)))


def simulate(seeds: int = 5) -> None:
    """Print how a fixed grip and ours hold the object, for some frictions and noises."""
    print("friction  fixed 2 N      slip margin held: slid (mm), force over the least that holds")
    for friction in (0.25, 0.35, 0.5, 0.7, 1.0):
        fixed = hold(None, friction)
        ours = [hold(SlipGrip(force=2.0), friction, seed) for seed in range(seeds)]
        slid = 1e3 * np.array([outcome.slid for outcome in ours])
        dropped = sum(outcome.dropped for outcome in ours)
        text = "dropped" if fixed.dropped else f"{fixed.force_ratio:.2f}"
        found = f"{slid.mean():.1f}, at most {slid.max():.1f} mm"
        if dropped:
            found += f", {dropped} of {seeds} dropped"
        ratio = np.nanmean([outcome.force_ratio for outcome in ours])
        print(f"{friction:8.2f}  {text:13s}  {found}   {ratio:.2f}")


def set_down(begin: float, table: float, lift: float) -> Callable[[float], float]:
    """Share of the weight that fingers carry of an object that is set down at `begin` (s), stands
    on a table for `table` (s) and is set down and lifted within `lift` (s)."""
    at = [begin, begin + lift, begin + table, begin + table + lift]
    return lambda time: float(np.interp(time, at, [1.0, 0.0, 0.0, 1.0]))


def swing(rate: float) -> Callable[[float], float]:
    """The same of an object that swings by 30 %, `rate` times a second."""
    return lambda time: 1.0 + 0.3 * math.sin(2.0 * math.pi * rate * time)


def simulate_loads() -> None:
    """Print how ours holds objects whose load comes and goes, and what a dead time costs."""

    def told(what: str, outcomes: list[Outcome]) -> None:
        slid = 1e3 * np.array([outcome.slid for outcome in outcomes])
        dropped = sum(outcome.dropped for outcome in outcomes)
        ratio = np.mean([o.force_ratio for o in outcomes if not o.dropped])
        print(
            f"{what}: {dropped} of {len(outcomes)} dropped, slid {slid.mean():.1f} mm, at most "
            f"{slid.max():.1f} mm; {ratio:.2f} of the least force"
        )

    for table, lift, begin in ((1.5, 0.1, 5.0), (3.0, 0.2, 5.0), (6.0, 0.2, 3.0)):
        for keep in (0.0, SlipGrip.keep):
            grips = [
                hold(SlipGrip(force=2.0, keep=keep), friction, seed, lifted=lifted)
                for lifted in [set_down(begin, table, lift)]
                for friction in (0.25, 0.35, 0.5, 0.7, 1.0)
                for seed in range(3)
            ]
            told(f"{table:g} s on a table, lifted within {lift:g} s, keep {keep:g}", grips)
    for rate in (1.0, 2.0, 4.0, 8.0):
        grips = [
            hold(SlipGrip(force=2.0), friction, seed, lifted=swing(rate))
            for friction in (0.25, 0.35, 0.5, 0.7)
            for seed in range(3)
        ]
        told(f"a swing of 30 %, {rate:g} a second", grips)
    for rate in (100.0, 50.0, 25.0):
        grips = [
            hold(SlipGrip(force=2.0), friction, seed, rate=rate)
            for friction in (0.25, 0.35, 0.5, 0.7, 1.0)
            for seed in range(3)
        ]
        told(f"{rate:g} samples a second", grips)
    for begin in (3.0, 4.3, 6.0):
        grips = [
            hold(SlipGrip(force=2.0), friction, seed, silent=(begin, begin + 1.2))
            for friction in (0.25, 0.35, 0.5, 0.7, 1.0)
            for seed in range(3)
        ]
        told(f"no samples for 1.2 s from {begin:g} s on", grips)
    for delay in (0.02, 0.03, 0.05):
        grips = [hold(SlipGrip(force=2.0), 0.25, seed, delay=delay) for seed in range(4)]
        told(f"friction 0.25, dead time {1e3 * delay:g} ms", grips)
    for friction in (0.25, 0.5, 1.0):
        late = {"force": 2.0, "dither": 0.0, "unsure": 1.0}
        grips = [hold(SlipGrip(**late), friction, seed, delay=0.1) for seed in range(4)]
        told(f"friction {friction:g}, dead time 100 ms, dither 0, unsure 1", grips)


def run_node() -> None:
    """Answer contact_slip with grip_force until Ctrl-C."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float64

    from finger_common.stamps import header_stamp, seconds
    from finger_msgs.msg import ContactSlip

    rclpy.init()
    node = rclpy.create_node("slip_grip")
    controller = from_parameters(node, SlipGrip)
    publisher = node.create_publisher(Float64, "grip_force", 1)
    # A steady clock: what is stale must not depend on a clock that may stop or be set.
    steady = rclpy.clock.Clock(clock_type=rclpy.clock.ClockType.STEADY_TIME)

    def now() -> float:
        return steady.now().nanoseconds * 1e-9

    received = silent = now()
    present: set[str] = set()
    log = node.get_logger()

    def tell(what: str, text: str) -> None:
        """Log a state, once."""
        if what not in present:
            present.add(what)
            log.warning(text)

    def end(what: str, text: str) -> None:
        """Log that a state has ended that was told."""
        if what in present:
            present.remove(what)
            log.info(text)

    def command(force: float) -> None:
        if not math.isnan(force):
            publisher.publish(Float64(data=force))

    def watch() -> None:
        """Tell the force while nothing comes: a gripper that hears nothing may let go."""
        nonlocal silent
        silence = now() - received
        if silence <= STALE_AFTER:
            return
        silent = received + silence
        force = controller.on_silence()
        grips = not math.isnan(force)
        what = f"holding {force:.2f} N" if grips else "no grip"
        tell(
            "silent" if grips else "no grip",
            f"{what}: no contact_slip comes, or not every {1e3 * STALE_AFTER:.0f} ms, on "
            f"{subscription.topic_name} (publishers: {subscription.get_publisher_count()})",
        )
        command(force)

    def tell_state(state: ContactSlip, force: float, begins: bool) -> None:
        """Log what keeps the grip from its work."""
        end("no grip", "contact_slip comes")
        if received - silent > SETTLED:
            end("silent", "contact_slip comes again")
        if math.isnan(state.slip_margin):
            return
        if state.slip_margin_stddev >= 1.0:
            why = "the zero of the force is in doubt (FORCE_OFFSET)"
            text = f"does not loosen its grip of {force:.2f} N: {why}"
            if begins:
                text = (
                    f"begins with {force:.2f} N as measured, but {why}: if more holds the object, "
                    "give it as the parameter 'force'"
                )
            tell("doubt", text)
        else:
            end("doubt", "the zero of the force is not in doubt any more")
        if controller.short:
            tell(
                "short",
                f"the load may need {controller.needed:.1f} N, more than 'largest', "
                f"{controller.largest:g} N: it may slip",
            )
        else:
            end("short", "'largest' is enough again")
        if abs(controller.follows - 1.0) > AMISS:
            tell(
                "amiss",
                f"the measured force is {controller.follows:.2f} of the commanded one: the grip "
                "may slip, or grow to 'largest'; check gripper, sensor and scale of grip_force",
            )
        elif abs(controller.follows - 1.0) < 0.5 * AMISS:
            end("amiss", "the measured force is the commanded one again")

    def on_slip(state: ContactSlip) -> None:
        nonlocal received
        received = now()
        begins = math.isnan(controller.force)
        force = controller.on_slip(
            seconds(header_stamp(state)),
            state.normal_force,
            state.slip_margin,
            state.friction,
            state.friction_stddev,
            state.slip_probability,
            state.flags,
            state.slip_margin_stddev,
        )
        command(force)
        tell_state(state, force, begins)

    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    subscription = node.create_subscription(ContactSlip, "contact_slip", on_slip, qos)
    node.create_timer(0.01, watch, clock=steady)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def main() -> None:
    """Run the simulation or the node."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--node", action="store_true", help="run the ROS node")
    parser.add_argument("--loads", action="store_true", help="simulate other loads and grippers")
    values = parse_arguments(parser)
    if values.node:
        run_node()
        return
    if "--ros-args" in sys.argv:
        parser.error("arguments of ROS are for the node; give --node")
    try:
        (simulate_loads if values.loads else simulate)()
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()

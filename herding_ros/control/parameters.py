# SPDX-License-Identifier: Apache-2.0
"""Parameters of the controller."""

from __future__ import annotations

from dataclasses import dataclass

from herding_ros.model.bodies import Body
from herding_ros.model.delay import delay_quantity, periods
from herding_ros.model.flock import Allowance
from herding_ros.model.motion import Holonomic, MotionModel
from herding_ros.model.parameters import Parameters, quantity, TINY


@dataclass(frozen=True)
class Weights(Parameters):
    """What the cost weighs; the paper's are centre 1, spread 1, control 1e-2, and 0."""

    centre: float = quantity(
        0.0,
        "weight of half the square of the centre's distance from its reference",
        low=0.0,
        live=True,
    )
    spread: float = quantity(
        3.0, "weight of the sheep's distance from their centre", low=0.0, live=True
    )
    control: float = quantity(1e-2, 'weight gamma of the control', 's^2', low=TINY, live=True)
    dogs: float = quantity(
        3e-3,
        "weight of each dog's distance from the reference; keeps dogs from running off",
        low=0.0,
        live=True,
    )
    terminal: float = quantity(
        10.0,
        'weight of centre and spread at the end of the window: it counts as if it went on for '
        'so long',
        's',
        low=0.0,
        live=True,
    )
    containment: float = quantity(
        0.0,
        'weight of sheep outside the disc of this radius around the reference',
        '1/m',
        low=0.0,
        live=True,
    )
    radius: float = quantity(0.6, 'radius of that disc', 'm', low=0.0, live=True)
    distance: float = quantity(
        1.0, "weight of the centre's distance from its reference", 'm', low=0.0, live=True
    )
    beyond: float = quantity(
        1.0,
        'weight of what lies beyond the window: the time that dogs need to get behind strays',
        low=0.0,
        live=True,
    )
    walls: float = quantity(
        1.0,
        'weight of dogs that are nearer to a wall of the field than bodies.wall_distance and '
        'twice bodies.margin',
        'm^2',
        low=0.0,
        live=True,
    )
    spacing: float = quantity(
        0.1,
        'weight of two dogs that are nearer to each other than bodies.separation and twice '
        'bodies.margin; without a separation it has no effect',
        'm^2',
        low=0.0,
        live=True,
    )


@dataclass(frozen=True)
class Reference(Parameters):
    """The trajectory that the centre is asked to follow to the destination."""

    kind: str = quantity(
        'attainable',
        'speed at which the reference moves to the destination: the one at which the dogs can '
        'drive the flock, or (interpolated, as in the paper) what reaches it within one horizon',
        choices=('attainable', 'interpolated'),
    )


MOST_INTERVALS = 2000
"""Control periods in a window: more would take memory by the gigabyte."""


@dataclass(frozen=True)
class Horizon(Parameters):
    """The window that is planned, the part of it that is played, and the time grids."""

    length: float = quantity(20.0, 'time that is planned ahead', 's', low=TINY, live=True)
    accepted: float = quantity(
        10.0, 'time between two windows, half the length', 's', low=TINY, live=True
    )
    feedback: float = quantity(
        1.0,
        'age at which a plan is improved from what is observed, between two windows; no less '
        'than `accepted`: not at all',
        's',
        low=TINY,
        live=True,
    )
    control_period: float = quantity(0.1, 'time for which a command is constant', 's', low=1e-6)
    substeps: int = quantity(
        2, 'time steps of the prediction within a control period', low=1, high=1000
    )

    def __post_init__(self) -> None:
        """Check that the time grids fit into each other."""
        super().__post_init__()
        for name in ('length', 'accepted', 'feedback'):
            ratio = getattr(self, name) / self.control_period
            if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
                raise ValueError(
                    f'Horizon.{name} must be a multiple of control_period, '
                    f'{self.control_period!r}, got {getattr(self, name)!r}'
                )
        if self.intervals > MOST_INTERVALS:
            raise ValueError(
                f'Horizon.length must be at most {MOST_INTERVALS} times control_period, '
                f'{self.control_period!r}, got {self.length!r}'
            )
        if self.accepted > self.length:
            raise ValueError(
                f'Horizon.accepted must be at most the length, {self.length!r}, '
                f'got {self.accepted!r}'
            )

    @property
    def has_feedback(self) -> bool:
        """Whether plans are improved between two windows."""
        return self.feedback < self.accepted - 0.5 * self.control_period

    @property
    def intervals(self) -> int:
        """Number of control periods in a window."""
        return round(self.length / self.control_period)

    @property
    def dt(self) -> float:
        """Time step of the prediction [s]."""
        return self.control_period / self.substeps


class OutOfStepError(ValueError):
    """Raised when controller and world cannot be in lockstep."""


def check_lockstep(control_period: float, world_period: float) -> None:
    """Raise OutOfStepError unless a command lasts as long as the world waits for one [s]."""
    if not abs(control_period - world_period) <= 1e-6 * world_period:
        raise OutOfStepError(
            'horizon.control_period of the controller must be dt * substeps of the sim in '
            f'lockstep, {world_period:g} s, got {control_period:g} s'
        )


@dataclass(frozen=True)
class Coarse(Parameters):
    """The deterministic model that a plan is made with: all sheep, or their mean-field limit."""

    markers: int = quantity(
        128,
        'points that stand for a flock of more than twice as many sheep (its mean-field limit); '
        'smaller flocks are predicted sheep by sheep',
        low=1,
        high=1_000_000,
    )


@dataclass(frozen=True)
class Optimiser(Parameters):
    """How the deterministic problems are solved."""

    method: str = quantity(
        'pqn',
        'projected quasi-Newton, spectral projected gradient, or (the paper) projected nonlinear '
        'conjugate gradient',
        choices=('pqn', 'spg', 'ncg'),
    )
    tolerance: float = quantity(
        1e-4,
        'pqn has converged when the next step promises to decrease the objective by less than '
        'this part of it',
        low=0.0,
    )
    step_tolerance: float = quantity(
        1e-4,
        'spg has converged when the projected gradient is no longer than this, as a step that is '
        'short; ncg when the last step is not',
        'm/s^0.5',
        low=0.0,
    )
    max_iterations: int = quantity(60, 'most iterations of one solve', low=1, high=10_000)
    feedback_iterations: int = quantity(
        5, 'most iterations of an improvement between two windows', low=1, high=10_000
    )
    rules: bool = quantity(
        True, 'start from what a rule of herding does, if that costs less than the last plan'
    )

    @property
    def tolerance_of_method(self) -> float:
        """Tolerance of the method that is chosen."""
        return self.tolerance if self.method == 'pqn' else self.step_tolerance


@dataclass(frozen=True)
class Mapping(Parameters):
    """Monte Carlo space mapping: the correction of a plan for the noise."""

    method: str = quantity(
        'output',
        "compare the models' outputs, or (aggressive: the paper's Algorithm 1) their controls",
        choices=('output', 'aggressive'),
    )
    estimator: str = quantity(
        'multilevel',
        'expected centre from differences to a cheaper model, or (the paper) from plain paths',
        choices=('multilevel', 'plain'),
    )
    standard_error: float = quantity(
        1e-3,
        'standard error of the expected centre that is small enough; 0 does all `paths` allows',
        'm',
        low=0.0,
    )
    paths: int = quantity(
        100,
        'most work of an evaluation of the fine model, in Monte Carlo paths',
        low=2,
        high=10_000,
    )
    max_iterations: int = quantity(
        3, 'most corrections of a plan; 0 plans without noise', low=0, high=1000
    )
    tolerance: float = quantity(
        1e-3,
        "output: root mean square of the expected centre's error that is small enough; 0 takes "
        'all iterations',
        'm',
        low=0.0,
    )
    residual: float = quantity(
        0.3,
        'aggressive: residual |T(u_f) - u_c*| / |u_c*| that is small enough; 0 takes all '
        'iterations',
        low=0.0,
    )
    feedback: bool = quantity(
        False,
        'correct plans between two windows as well, by the error of the expected centre that was '
        'found last; one evaluation of the fine model in each feedback brings it up to date',
    )


@dataclass(frozen=True)
class Sensor(Parameters):
    """The noise of observations that the controller filters out; by default none."""

    position_noise: float = quantity(
        0.0,
        'standard deviation of observed positions that is filtered out; 0: they are exact',
        'm',
        low=0.0,
    )
    velocity_noise: float = quantity(
        0.0,
        'standard deviation of observed velocities that is filtered out; 0: they are exact',
        'm/s',
        low=0.0,
    )
    model_noise: float = quantity(
        0.005,
        'least random force on sheep that the filter expects, for errors of the model: without '
        'any it would soon ignore observations',
        'm/s^1.5',
        low=0.0,
    )
    slip: float = quantity(
        0.01,
        'strength of the random walk of a dog off where its commands lead',
        'm/s^0.5',
        low=0.0,
    )
    timeout: float = quantity(
        10.0,
        'time out of sight after which a sheep is lost; until then it is carried along by the '
        'model, if a noise is above 0. Longer than any time between two observations',
        's',
        low=TINY,
    )

    @property
    def is_exact(self) -> bool:
        """Whether there is nothing to filter out."""
        return not (self.position_noise or self.velocity_noise)


@dataclass(frozen=True)
class Bodies(Body):
    """Bodies of dogs, and how their commands keep them apart. Distances are between middles."""

    separation: float = quantity(
        0.1, 'distance that commands keep between two dogs; 0: none', 'm', low=0.0, live=True
    )
    sheep_distance: float = quantity(
        0.0,
        'distance that commands keep from sheep as long as these stand; 0: none',
        'm',
        low=0.0,
        live=True,
    )
    wall_distance: float = quantity(
        0.05,
        'distance that commands keep between the middle of a dog and a wall of the field',
        'm',
        low=0.0,
        live=True,
    )
    margin: float = quantity(
        0.03,
        'what commands keep in addition to these distances, since odometry is not exact',
        'm',
        low=0.0,
        live=True,
    )
    delay: float = quantity(
        0.25,
        'distances are kept if commands take effect, on dogs as observed, this late at most; '
        'dogs pass each other the more slowly for it',
        's',
        low=0.0,
        live=True,
    )
    ramp: float = quantity(
        0.5,
        'time that a command takes from rest to full speed, which bounds how fast it changes, but '
        'for stops and to keep dogs apart; 0: none',
        's',
        low=0.0,
        live=True,
    )

    def __post_init__(self) -> None:
        """Check that dogs that are kept apart do not touch."""
        super().__post_init__()
        if 0.0 < self.separation < 2.0 * self.radius:
            raise ValueError(
                f'Bodies.separation must be 0 or at least twice the radius, '
                f'{2.0 * self.radius:g} m, got {self.separation!r}'
            )


@dataclass(frozen=True)
class Timing(Parameters):
    """How far ahead a pilot plans, and how long it waits."""

    lead: float = quantity(
        2.0, 'time before its window at which a plan is begun, not in lockstep', 's', low=0.0
    )
    state_timeout: float = quantity(
        1.0,
        'not in lockstep, observations older than this do not count: without sheep the dogs '
        'stop, without its odometry a dog is left out of the plans',
        's',
        low=TINY,
    )


@dataclass(frozen=True)
class Control(Parameters):
    """All parameters of the controller besides the crowd."""

    max_speed: float = quantity(5e-2, 'speed limit u_max of the dogs', 'm/s', low=TINY, live=True)
    motion: MotionModel = Holonomic()
    delay: float = delay_quantity(
        'time until dogs carry out a command, which is predicted; what may come on top of it is '
        'bodies.delay'
    )
    dog_timeout: float = quantity(
        2.0,
        'a dog that has not run as told for so long is left out of the plans until it does; '
        '0: never',
        's',
        low=0.0,
    )
    weights: Weights = Weights()
    reference: Reference = Reference()
    horizon: Horizon = Horizon()
    coarse: Coarse = Coarse()
    optimiser: Optimiser = Optimiser()
    mapping: Mapping = Mapping()
    sensor: Sensor = Sensor()
    bodies: Bodies = Bodies()
    arrival: Allowance = Allowance()

    def __post_init__(self) -> None:
        """Check what goes together."""
        super().__post_init__()
        periods('Control.delay', self.delay, self.horizon.control_period)

    @property
    def periods_of_delay(self) -> int:
        """The delay in control periods."""
        return periods('Control.delay', self.delay, self.horizon.control_period)


PAPER = Control(
    weights=Weights(distance=0.0, centre=1.0, spread=1.0, dogs=0.0, beyond=0.0, terminal=0.0),
    reference=Reference(kind='interpolated'),
    horizon=Horizon(feedback=10.0),
    optimiser=Optimiser('spg', step_tolerance=5e-3, rules=False),
    mapping=Mapping('aggressive', 'plain', standard_error=0.0),
    bodies=Bodies(separation=0.0, ramp=0.0),
    dog_timeout=0.0,
)
"""The paper's own setting: equal weights, interpolated reference, aggressive mapping."""

CONTROLS = {'default': Control(), 'paper': PAPER}
"""Settings by the name that the controller's parameter `preset` takes."""

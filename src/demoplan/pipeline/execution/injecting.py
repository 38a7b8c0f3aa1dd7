"""Lets one fault happen in a run, at the step that it names, in the session or in what is perceived."""

import zlib
from dataclasses import dataclass

import numpy as np

from demoplan.engines.mujoco.session import Motion, Session
from demoplan.language.execution import GroundOperator
from demoplan.manifests.faults import (
    AnyFault,
    FlippedPredicateFault,
    StalePredicateFault,
    WrongLiteralFault,
)
from demoplan.pipeline.execution.faults import CLASS_OF_KIND, world_fault
from demoplan.pipeline.execution.senses import Misreading, Senses
from demoplan.stages.diagnose import FailureClass
from demoplan.stages.monitor import effects_of


@dataclass(frozen=True)
class _Due:
    """The step at which the fault happens."""

    hand: str
    motion: Motion
    step: GroundOperator
    planned: frozenset[str]
    at_ns: int | None
    """When something happens to the world; None if it is perception that errs, or once it has happened."""


class Injector:
    """One fault, or none. Nobody who monitors asks it anything."""

    def __init__(self, fault: AnyFault | None, session: Session, senses: Senses, seed: int) -> None:
        """Wait for the fault's step. A fault of the operator model has happened already, in the domain."""
        self.fault, self._session, self._senses = fault, session, senses
        self.happened_ns: int | None = 0 if isinstance(fault, WrongLiteralFault) else None
        """When it happened; a fault of the operator model, from the start [ns]."""
        self.has_shown = False
        """It has happened, and if it is one of the operator model, a step of such an operator has ended."""
        # What is random is drawn before anything runs: how a run is monitored changes nothing about it.
        name = 0 if fault is None else zlib.crc32(fault.name.encode())
        self._rng = np.random.default_rng([seed, 0x0FA17, name])
        self._angle_rad = float(self._rng.uniform(0.0, 2.0 * np.pi))
        self._due: _Due | None = None

    @property
    def is_done(self) -> bool:
        """Whether it has happened."""
        return self.happened_ns is not None

    @property
    def true_class(self) -> FailureClass | None:
        """The fault's true class, for the rows."""
        return None if self.fault is None else CLASS_OF_KIND[self.fault.kind]

    def dispatched(
        self, hand: str, motion: Motion, number: int, step: GroundOperator, planned: frozenset[str]
    ) -> None:
        """A step is being dispatched.

        Args:
            hand: Hand that moves.
            motion: What it does.
            number: How many steps of the activity there have been, this one included.
            step: With the effects that last.
            planned: Objects that the plan speaks of.
        """
        fault = self.fault
        if fault is None or self.is_done or self._due is not None:
            return
        if motion.activity != fault.at.activity or number != fault.at.occurrence:
            return
        is_symbolic = isinstance(fault, FlippedPredicateFault | StalePredicateFault)
        at_ns = None if is_symbolic else self._session.time_ns + round(fault.at.delay_s * 1e9)
        self._due = _Due(hand, motion, step, planned, at_ns)
        if isinstance(fault, StalePredicateFault):
            self._misread(fault)
        self.time_passed()

    def time_passed(self) -> None:
        """Let the fault happen if it is due."""
        due, fault = self._due, self.fault
        if self.is_done or due is None or fault is None or due.at_ns is None:
            return
        if self._session.time_ns < due.at_ns:
            return
        self._due = _Due(due.hand, due.motion, due.step, due.planned, None)
        event = world_fault(
            fault,
            self._session,
            hand=due.hand,
            thing=due.motion.object,
            support=due.motion.support,
            planned=due.planned,
            angle_rad=self._angle_rad,
            rng=self._rng,
        )
        if event is not None:
            self._session.inject(event)
            self._happen()

    def ended(self, step: GroundOperator, activity: str) -> None:
        """A step has ended: if it is the one, perception errs about its effects from now on."""
        if isinstance(self.fault, WrongLiteralFault) and self.fault.activity == activity:
            self.has_shown = True
        is_here = self._due is not None and self._due.step == step and not self.is_done
        if isinstance(self.fault, FlippedPredicateFault) and is_here:
            self._misread(self.fault)

    def _misread(self, fault: FlippedPredicateFault | StalePredicateFault) -> None:
        assert self._due is not None
        effects = effects_of(self._due.step)
        atoms = frozenset(effect.atom for effect in effects if effect.atom.predicate == fault.predicate)
        if not atoms:
            return
        is_stale = isinstance(fault, StalePredicateFault)
        self._senses.misreadings.append(
            Misreading(
                atoms=atoms,
                until_ns=self._session.time_ns + round(fault.duration_s * 1e9),
                says=self._senses.look().held & atoms if is_stale else None,
            )
        )
        self._happen()

    def _happen(self) -> None:
        self.happened_ns, self.has_shown = self._session.time_ns, True

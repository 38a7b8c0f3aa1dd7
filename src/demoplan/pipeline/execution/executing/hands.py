"""Motions and time: whatever a hand is told to do comes to an end, by itself or by a limit."""

from demoplan.engines.mujoco.session import Motion, MotionReport, Session
from demoplan.pipeline.execution.executing.course import Course
from demoplan.pipeline.execution.executing.endings import RunEnded
from demoplan.pipeline.execution.executing.params import ExecuteParams
from demoplan.pipeline.execution.executing.rows import Row
from demoplan.pipeline.execution.injecting import Injector


class Hands:
    """The hands of a session's robot, and its clock."""

    def __init__(self, session: Session, injector: Injector, params: ExecuteParams) -> None:
        """All hands rest."""
        self.session, self._injector, self._params = session, injector, params
        self._retiring: dict[str, tuple[int, Row]] = {}

    def advance(self, duration_s: float) -> None:
        """Let time pass, and let happen what is due."""
        self.session.advance(duration_s)
        self._injector.time_passed()

    def check_time(self) -> None:
        """End a run that takes too long."""
        if self.session.time_ns / 1e9 > self._params.run_timeout_s:
            raise RunEnded("timeout", f"the run took more than {self._params.run_timeout_s:.0f} s")

    def is_late(self, start_ns: int) -> bool:
        """Whether a motion that began then has had its time."""
        return (self.session.time_ns - start_ns) / 1e9 >= self._params.step_timeout_s

    def move(self, hand: str, motion: Motion) -> MotionReport:
        """Make a motion, to its end."""
        report = self.session.start(hand, motion)
        start_ns = self.session.time_ns
        while report.state == "running":
            self.check_time()
            self.advance(self._params.poll_s)
            if (self.session.time_ns - start_ns) / 1e9 > self._params.step_timeout_s:
                self.session.cancel(hand)
            report = self.session.report(hand) or report
        return report

    @property
    def retiring(self) -> frozenset[str]:
        """Hands that are on their way out of the way of others."""
        return frozenset(self._retiring)

    def retire(self, hand: str, row: Row) -> None:
        """Send a hand to rest; time goes on meanwhile."""
        self._retiring[hand] = self.session.time_ns, row
        row |= {"state": "executing", "start_ns": self.session.time_ns}
        self.session.start(hand, Motion(activity="Idle", skill="rest"))

    def note_retired(self) -> None:
        """Write down which hands have come to rest; one that takes too long stays where it is."""
        for hand, (start_ns, row) in sorted(self._retiring.items()):
            report = self.session.report(hand)
            if report is not None and report.state == "running":
                if not self.is_late(start_ns):
                    continue
                self.session.cancel(hand)
                report = self.session.report(hand)
            is_well = report is not None and report.state == "succeeded"
            row |= {"state": "succeeded" if is_well else "failed", "end_ns": self.session.time_ns}
            row["cause"] = None if report is None else report.reason
            del self._retiring[hand]

    def await_retired(self) -> None:
        """Let hands that are going to rest get there."""
        self.note_retired()
        while self._retiring:
            self.session.advance(self._params.poll_s)
            self.note_retired()

    def stop(self, course: Course) -> None:
        """Let motions that are under way come to their end: a hand that stops midway helps nobody."""
        for hand, running in sorted(course.running.items()):
            report = self.session.report(hand)
            while report is not None and report.state == "running":
                self.session.advance(self._params.poll_s)
                if (self.session.time_ns - running.start_ns) / 1e9 > self._params.step_timeout_s:
                    self.session.cancel(hand)
                report = self.session.report(hand)
            if running.row["state"] == "executing":
                is_well = report is not None and report.state == "succeeded"
                running.row |= {
                    "state": "succeeded" if is_well else "cancelled",
                    "end_ns": self.session.time_ns,
                }
        course.running.clear()
        self.await_retired()
        self.session.advance(self._params.lag_s)

"""Whether counts are a rule or a mistake: posteriors by marginal likelihood, with the noise rate unknown.

What each literal is to its operator, ``demoplan.inference`` says for traces and logs alike; here is what is
asked of single counts. A fixed threshold ("seen in 90 %") is too strict for small samples and too lax for
large ones. Each hypothesis is scored by the likelihood of the counts with its rate
integrated out, so that what is believed depends on how much was seen.

Source: D. J. C. MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapters 3 and 28.
It replaces the entropy rule of A. Mitrevski et al., by which one exception rules a precondition out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, lgamma


@dataclass(frozen=True)
class Noise:
    """A Beta prior over the rate at which observations are wrong."""

    mean: float
    weight: float

    def log_likelihood(self, n_right: int, n_wrong: int) -> float:
        """Log probability of one sequence with so many right and wrong observations, rate integrated out."""
        wrong, right = self.mean * self.weight, (1 - self.mean) * self.weight
        return _log_beta(wrong + n_wrong, right + n_right) - _log_beta(wrong, right)


def _log_beta(a: float, b: float) -> float:
    return lgamma(a) + lgamma(b) - lgamma(a + b)


def _log_any(*counts: int) -> float:
    """Log probability of one sequence of two outcomes whose rate may be anything (uniform prior)."""
    a, b = counts
    return _log_beta(a + 1.0, b + 1.0)


def _posterior(logs: Sequence[float]) -> float:
    """Posterior of the first of several hypotheses that are equally likely beforehand."""
    top = max(logs)
    weights = [exp(value - top) for value in logs]
    return weights[0] / sum(weights)


def is_required(n_support: int, n_against: int, noise: Noise) -> float:
    """Posterior that a condition holds whenever the activity happens, exceptions being noise.

    The other hypothesis is that it holds as often as it may, regardless of the activity.

    >>> noise = Noise(0.05, 20)
    >>> [round(is_required(n, k, noise), 2) for n, k in ((0, 0), (1, 0), (20, 0), (27, 3), (15, 15))]
    [0.5, 0.66, 0.91, 0.74, 0.0]
    """
    return _posterior([noise.log_likelihood(n_support, n_against), _log_any(n_support, n_against)])


def is_mistake(n_cases: int, n_all: int, noise: Noise) -> float:
    """Posterior that ``n_cases`` of ``n_all`` are mistakes, and not a rarer way of doing the same.

    >>> noise = Noise(0.05, 20)
    >>> is_mistake(1, 30, noise) > 0.5, is_mistake(3, 12, noise) > 0.5, is_mistake(1, 2, noise) > 0.5
    (True, False, False)
    """
    rest = n_all - n_cases
    return _posterior([noise.log_likelihood(rest, n_cases), _log_any(rest, n_cases)])

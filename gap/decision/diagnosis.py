"""A diagnosis that is computed once for the same data, and read again after that."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from gap.data.dataset import DataSet
from gap.decision.codec import decode, encode
from gap.decision.diagnose import candidates_without, diagnose_with_search
from gap.decision.fingerprint import fingerprint
from gap.decision.store import Store, user_folder
from gap.estimation.fit_problem import FitProblem, FitResult, ProblemState
from gap.estimation.standards import with_known_errors
from gap.selection.search import SearchResult
from gap.verdict import Verdict


@dataclass(frozen=True)
class _Fits:
    """The fits behind a verdict, in the form that is kept."""

    state: ProblemState
    search: SearchResult | None


@dataclass(frozen=True)
class _Entry:
    verdict: Verdict
    fits: _Fits | None


class Diagnosis:
    """The verdict on a data set and the fits behind it.

    Attributes:
        verdict: what the diagnosis found.
        kept: whether it was read instead of computed.
        problem, search: see `gap.decision.diagnose.diagnose_with_search`; of a diagnosis that was
            read they are set up again when they are first asked for.
    """

    def __init__(self, data: DataSet, without: frozenset[str], entry: _Entry) -> None:
        self.verdict = entry.verdict
        self.kept = True
        self._data = data
        self._without = without
        self._fits = entry.fits
        self._problem: FitProblem | None = None
        self._search: SearchResult | None = None

    @classmethod
    def computed(cls, data: DataSet, without: frozenset[str]) -> Diagnosis:
        """Computed anew."""
        verdict, problem, search = diagnose_with_search(data, without)
        made = cls(data, without, _Entry(verdict, None))
        made.kept = False
        made._problem, made._search = problem, search
        return made

    @property
    def problem(self) -> FitProblem | None:
        """The fit problem; None where the data are unfit or nothing can be compared."""
        self._set_up()
        return self._problem

    @property
    def search(self) -> SearchResult | None:
        """The search, without what it could not prove."""
        self._set_up()
        return self._search

    @property
    def fit(self) -> FitResult | None:
        """The fit that the verdict speaks of."""
        return self.search.best.fit if self.search is not None else None

    def entry(self) -> _Entry:
        """What is kept of it."""
        problem, search = self._problem, self._search
        return _Entry(self.verdict, _Fits(problem.state(), search) if problem else None)

    def _set_up(self) -> None:
        if self._fits is None:
            return
        fits, self._fits = self._fits, None
        data, check = with_known_errors(self._data)
        candidates = candidates_without((*self._without, *check.cleared))
        self._problem = FitProblem.restored(data, fits.state, candidates)
        search = fits.search
        if search is not None and not search.best.keys:
            # The recalibrated plant itself, whose sensitivities are known.
            search = replace(search, best=replace(search.best, fit=self._problem.base))
        self._search = search


def diagnosis(data: DataSet, without: Iterable[str] = (), keep: bool = True) -> Diagnosis:
    """The diagnosis of a data set: read if it was made before from the same content.

    Args:
        data: the data set, with its simulator.
        without: effects that are struck from the catalogue.
        keep: whether to read and to keep it in the user's cache; see `user_folder`.

    Raises:
        GapError: as `gap.decision.diagnose.diagnose`.
    """
    struck = frozenset(without)
    candidates_without(struck)  # an unknown effect is an error before anything is computed
    folder = user_folder() if keep else None
    key = fingerprint(data, struck) if folder is not None else None
    if folder is None or key is None:
        return Diagnosis.computed(data, struck)
    store = Store(folder)
    found = _read(store, key)
    if found is not None:
        return Diagnosis(data, struck, found)
    made = Diagnosis.computed(data, struck)
    arrays: list[object] = []
    store.write(key, encode(_Entry, made.entry(), arrays), arrays)
    return made


def _read(store: Store, key: str) -> _Entry | None:
    found = store.read(key)
    if found is None:
        return None
    try:
        entry: _Entry = decode(_Entry, *found)
        if entry.fits is not None:
            entry.fits.state.check()
    except (ValueError, TypeError, KeyError, IndexError, AttributeError):
        return None
    return entry

"""One file for each test protocol: its parameters, its method, its table and its screen.

To add a protocol NAME (`docs/extending.md` has an example):

1. ``names.py``: one line, command and summary (and a rig of its own, if "virtual" lacks something);
2. ``NAME.py`` here with ``PROCEDURE`` (``rigs.execution.procedure.Procedure``): ``read`` its TOML
   into a frozen dataclass with ``name``, ``frames``, ``as_dict()`` and ``steps()``; ``firmware``
   settings that differ from the rig's. ``parts`` holds what protocols share;
3. ``analysis/findings/NAME.py`` with ``ANALYSES``: ``reduce`` a run to its table
   (``analysis.reduction.points.reduce_points`` for settled points), ``findings`` from that table,
   ``layout`` of its screen; and one line in ``analysis/registry.py``;
4. ``configs/protocols/NAME.toml`` and ``NAME-short.toml`` (at most 15 s).

A step that only this protocol knows is a dataclass derived from
``rigs.steps.custom_step.CustomStep``: it states how long it takes and how many points it makes,
and ``perform(runner)`` carries it out with ``runner.rig``, ``runner.record`` (streams and events)
and ``runner.window`` (samples of the next seconds). ``steps()`` is walked through without a bench
beforehand (``schedule.outline``), so it must accept None as the answer of a ``CustomStep``.
"""

"""One file for each test protocol: its parameters, its method, its table and its screen.

To add a protocol NAME:

1. ``names.py``: one line, command and summary (and a rig of its own, if "virtual" lacks something);
2. ``NAME.py`` here with ``PROCEDURE`` (``procedure.Procedure``): ``read`` its TOML into a frozen
   dataclass with ``name``, ``frames``, ``as_dict()`` and ``steps()``; ``reduce`` a run to its table
   (``analysis.reduction.points.reduce_points`` for settled points); ``findings`` from that table;
   ``layout`` of its screen; ``firmware`` settings that differ from the rig's;
3. ``configs/protocols/NAME.toml`` and ``NAME-short.toml`` (at most 15 s).

A step that only this protocol knows is a dataclass derived from
``rigs.steps.custom_step.CustomStep``: it says how long it takes and how many points it makes,
and ``perform(runner)`` does it with ``runner.rig``, ``runner.record`` (streams and events) and
``runner.window`` (samples of the next seconds). ``steps()`` is walked through without a bench
beforehand (``schedule.outline``), so it must take None for the answer of an Act.
"""

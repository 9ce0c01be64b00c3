"""Controllers of the finger. All act through the firmware, one valve controller per muscle.

`bench.FingerBench` connects firmware and simulated finger. `loop.run_law` closes a control loop
around it. The laws are in `statics`, `pid`, `placement`, `feedforward` and `adaptive`; `tuning`
determines their gains.
"""

"""Controllers of the finger, all through the firmware: one valve controller a muscle.

`bench.FingerBench` joins firmware and simulated finger; `loop.run_law` closes a loop around it;
the laws are `statics`, `pid`, `placement`, `feedforward`, `adaptive`; `tuning` finds their gains.
"""

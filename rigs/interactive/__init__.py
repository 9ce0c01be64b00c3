"""Interactive use: a rig held open by a process of its own, driven from a notebook.

``client.py`` is what the user calls. ``worker.py`` is the process that holds the rig: it runs the
same session, runner and record as every test. Its steps come from the user instead of a protocol.
"""

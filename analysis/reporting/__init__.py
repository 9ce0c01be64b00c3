"""The report of a run, its figures, and the folder of derived files."""

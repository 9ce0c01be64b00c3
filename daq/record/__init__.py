"""Writing and checking the files of a run record."""

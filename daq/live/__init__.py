"""The live view and the view file, with the Rerun viewer."""

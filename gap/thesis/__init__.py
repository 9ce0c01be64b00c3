"""The measured tables of the thesis, diagnosed."""

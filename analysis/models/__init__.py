"""Points for models, and figures and texts of their fits and comparisons."""

"""Controllers compared: studies, spread, figures and reports."""

"""Comparison of controllers: studies, spread over noise, figures and reports."""

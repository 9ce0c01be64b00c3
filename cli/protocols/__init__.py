"""Commands that run tests, plans of tests, and requests to a running test."""

"""Simulations of whole benches and controllers, and the questions put to them."""

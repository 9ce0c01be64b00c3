"""A second bench with its own physics, integrator and noise, for checking the diagnosis blindly.

It imports nothing of the other packages: what it hides must not be found by shared code.
"""

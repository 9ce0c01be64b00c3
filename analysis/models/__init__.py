"""Points for model fits, and fits as text and figures."""

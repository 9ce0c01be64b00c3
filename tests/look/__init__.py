"""Pictures of what a person sees; run by ``make look``."""

"""The blind check: data from a bench that shares no code with the diagnosis, scored blindly."""

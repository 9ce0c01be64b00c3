"""Files made from questions: a rig file and a protocol file, and the search for devices."""

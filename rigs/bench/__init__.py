"""A rig opened, checked, locked and made safe."""

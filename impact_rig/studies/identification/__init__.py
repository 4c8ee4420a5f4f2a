"""From measurements to the constants of the rig, and what the measurements cannot tell."""

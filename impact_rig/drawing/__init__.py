"""The one style of all drawings: colours by meaning, type and lines, legends, light and dark."""

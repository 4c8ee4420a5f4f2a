"""What many measurements say together: constants identified, margins of the statements."""

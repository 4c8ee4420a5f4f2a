"""The website: docs/ as pages, built by MkDocs with the theme Material, offline and strict."""

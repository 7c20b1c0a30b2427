"""Pictures with matplotlib, one module a subject."""

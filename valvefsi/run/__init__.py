"""A run in time: the loop, its steps, what it watches, records and expects to take."""

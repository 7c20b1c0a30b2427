"""valvefsi from Python and from notebooks: run a case, open what a run left."""

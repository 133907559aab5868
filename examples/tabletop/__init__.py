"""How the bundled example is made: shapes, looks, a physics pre-run, a path tracer, and honest damage."""

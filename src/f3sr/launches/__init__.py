"""Tasks to initial velocities: which launches to try, from closed forms, corrected by what came of them."""

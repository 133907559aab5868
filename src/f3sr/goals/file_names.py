"""The names of the files of a played goal and of its film."""

PLAN, ROLLOUT, VERDICT = "plan.json", "rollout.npz", "verdict.json"
FILM, STRIP, PLAYER = "film.mp4", "film.png", "player.html"
FILMS = (FILM, STRIP, PLAYER)

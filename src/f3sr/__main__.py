"""The process of the ``f3sr`` command: signals are looked after before anything heavy is imported."""

from f3sr import interrupts


def run() -> None:
    """Console script."""
    interrupts.watch()
    from f3sr import cli

    cli.run()


if __name__ == "__main__":
    run()

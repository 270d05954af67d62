"""The command `musebot`, also reached as `python -m musebot`."""

import sys


def main() -> int:
    """Runs the command line and returns its exit status."""
    try:
        from .protocols.cli import parser as cli
    except ModuleNotFoundError as error:  # without the extra `brain`
        from .protocols.errors import missing_extra

        print(f"musebot: {missing_extra(error)}", file=sys.stderr)
        return 2
    return cli.main()


if __name__ == "__main__":
    raise SystemExit(main())

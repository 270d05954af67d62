"""The command `musebot`, also reached as `python -m musebot`."""


def main() -> int:
    """Runs the command line and returns its exit status."""
    from .protocols.cli import parser

    return parser.main()


if __name__ == "__main__":
    raise SystemExit(main())

"""Subcommands of `finger-model`, one module each with `add_parser(subparsers)`."""

"""Tokens of users: made at random, read out and typed by people, and kept as a digest alone.

Sixteen letters of 32 are 80 bits: nobody guesses one, and a fast digest keeps it secret.
"""

import hashlib
import secrets

LETTERS = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"  # Crockford's: none looks like another one
GROUPS, GROUP = 4, 4
_READ_AS = str.maketrans({"O": "0", "I": "1", "L": "1", "-": None, " ": None})


def new_token() -> str:
    """A token such as ``7K3Q-09ZT-M4XW-B2HD``."""
    return "-".join("".join(secrets.choice(LETTERS) for _ in range(GROUP)) for _ in range(GROUPS))


def digest(token: str) -> str:
    """What is kept of a token; however it was typed, with small letters or without its dashes."""
    return hashlib.sha256(token.upper().translate(_READ_AS).encode("utf-8", "replace")).hexdigest()

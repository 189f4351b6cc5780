"""The token of a control server: whoever has it may work the devices."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from axistwin.errors import UsageError

TOKEN_VARIABLE: Final = "AXISTWIN_CONTROL_TOKEN"
TOKEN_MIN: Final = 16


def find_token(path: str | None, environment: Mapping[str, str]) -> str | None:
    """The token in the file at ``path``, else in the environment; None: there is none.

    Raises UsageError, which never shows it.
    """
    token, where = environment.get(TOKEN_VARIABLE), TOKEN_VARIABLE
    if path is not None:
        where = f"control token {path}"
        try:
            token = Path(path).read_text("ascii").strip()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is no text"
            raise UsageError(f"{where}: cannot be read ({reason}); give an existing file") from None
    if token is None:
        return None
    if len(token) < TOKEN_MIN or not (token.isascii() and token.isprintable()) or " " in token:
        raise UsageError(
            f"{where}: a token has at least {TOKEN_MIN} letters and digits, in one line; make one "
            "with 'openssl rand -hex 16'"
        )
    return token

"""What a board must answer and where its axes may be, whatever has been sent to it.

`states` holds the table of commands and states, `settings` what modal commands set, `motions` what
runs when, and `board` puts them together.
"""

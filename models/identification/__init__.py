"""Identifiers: from a recording and a nominal model to an identified one."""

from tests.runner.conftest import postgres, postgres_server

__all__ = ["postgres", "postgres_server"]

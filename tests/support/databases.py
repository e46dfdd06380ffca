"""Empty databases of each kind that the store supports."""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import create_engine, make_url

from karolos.store import Store

SERVER = os.environ.get("KAROLOS_TEST_POSTGRES")
"""URL of a PostgreSQL database whose user may make others; .ci/run starts one."""
KINDS = [
    "sqlite",
    pytest.param("postgresql", marks=pytest.mark.skipif(not SERVER, reason="KAROLOS_TEST_POSTGRES names no server")),
]


@contextmanager
def empty_database(kind: str, folder: Path) -> Iterator[str]:
    """URL of a database that is removed afterwards."""
    if kind == "sqlite":
        yield Store.default_url(folder)
        return
    server = create_engine(
        make_url(SERVER or ""), isolation_level="AUTOCOMMIT", connect_args={"client_encoding": "utf8"}
    )
    name = f"karolos_test_{uuid.uuid4().hex}"
    with server.connect() as connection:
        connection.exec_driver_sql(f"CREATE DATABASE {name}")
    try:
        yield server.url.set(database=name).render_as_string(hide_password=False)
    finally:
        with server.connect() as connection:
            connection.exec_driver_sql(f"DROP DATABASE {name} WITH (FORCE)")
        server.dispose()

"""Run history in SQLite, for the pages of `GET /runs`. The control process's ledger remains the original.

Nothing that moves or stops the robot waits for this database. If it cannot be used, `problem` says why and starts are
refused with that reason. Stop and status still work.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import JSON, URL, Connection, Index, String, event, inspect, make_url, select, tuple_
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.ext.asyncio import AsyncEngine, AsyncSession, async_sessionmaker, create_async_engine
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.pool import NullPool

from service.messages import Run, RunState

_log = structlog.get_logger("api.history")

BUSY_TIMEOUT_S = 1.0
RETRY_S = 1.0


class Base(DeclarativeBase):
    """Tables of the history."""


class RunRow(Base):
    """One run: the columns for queries, and the whole document as received from the control process."""

    __tablename__ = "runs"
    __table_args__ = (Index("runs_in_order", "seq", "requested_at", "id"),)

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    seq: Mapped[int] = mapped_column(server_default="0")
    requested_at: Mapped[float]
    recipe: Mapped[str] = mapped_column(String(64))
    state: Mapped[str] = mapped_column(String(16))
    code: Mapped[str | None] = mapped_column(String(32))
    document: Mapped[dict[str, Any]] = mapped_column(JSON)


class HistoryError(Exception):
    """The database cannot be used; the text says why and what to do."""


class RunHistory:
    """Reads and writes the run history.

    Args:
        url: `sqlite+aiosqlite:///file`; a missing folder of the file is created.

    Raises:
        ValueError: the URL names another database.
    """

    def __init__(self, url: str) -> None:
        parsed = self.check_url(url)
        self._path = Path(str(parsed.database))
        # No connection is kept: one that is open would go on with a file that was moved away
        self._engine: AsyncEngine = create_async_engine(
            parsed, connect_args={"timeout": BUSY_TIMEOUT_S}, poolclass=NullPool
        )
        event.listen(self._engine.sync_engine, "connect", _use_wal)
        self._sessions = async_sessionmaker(self._engine, expire_on_commit=False)
        self._pending: dict[str, Run] = {}
        self._wake = asyncio.Event()
        # SQLite allows one writer, so the writers of this process take turns.
        self._writing = asyncio.Lock()
        self._probing: asyncio.Task[None] | None = None
        self._opened = False
        self._identity: tuple[int, int] | None = None
        self.on_renewed: Callable[[], object] = lambda: None
        self.problem: str | None = None

    @staticmethod
    def check_url(url: str) -> URL:
        """Return the parsed URL.

        Raises:
            ValueError: the URL does not name an SQLite file.
        """
        parsed = make_url(url)
        if parsed.drivername != "sqlite+aiosqlite" or not parsed.database:
            raise ValueError(f"api.database must be sqlite+aiosqlite:///FILE, not {parsed.render_as_string()}")
        return parsed

    async def open(self) -> None:
        """Create the tables. A failure is kept in `problem`, not raised."""
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            async with self._engine.begin() as connection:
                await connection.run_sync(Base.metadata.create_all)
                await connection.run_sync(_number_runs)
            self._identity = self._present_identity()
        except (OSError, SQLAlchemyError) as error:
            self._note_failure(error)
        else:
            self._opened, self.problem = True, None

    async def close(self) -> None:
        if self._probing is not None:
            await self._probing
        await self._engine.dispose()

    async def check(self) -> None:
        """Check that a run can be recorded now.

        Raises:
            HistoryError: the database cannot be written.
        """
        if self._probing is None or self._probing.done():
            self._probing = asyncio.create_task(self._probe())
        await asyncio.shield(self._probing)
        if self.problem is not None:
            raise HistoryError(self.problem)

    async def _probe(self) -> None:
        await self._renew_if_moved()
        if not self._opened:
            await self.open()
        if not self._opened:
            return
        try:
            async with self._writing, self._engine.connect() as connection:
                await connection.exec_driver_sql("BEGIN IMMEDIATE")
                await connection.rollback()
        except SQLAlchemyError as error:
            self._note_failure(error)
        else:
            self.problem = None

    async def _renew_if_moved(self) -> None:
        """Make the database anew where the file at the path is not the one that was opened."""
        if self._opened and await asyncio.to_thread(self._present_identity) != self._identity:
            _log.warning("history", problem=f"{self._path} was moved or deleted; it is made anew from the ledger")
            self._opened = False
            await self.open()
            self.on_renewed()

    def _present_identity(self) -> tuple[int, int] | None:
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_dev, found.st_ino

    def put(self, run: Run) -> None:
        """Queue a new or changed run for `write_forever`; return at once."""
        self._pending[run.id] = run
        self._wake.set()

    async def write_forever(self) -> None:
        """Write the queued runs, retrying until the database accepts them."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            try:
                await self.flush()
            except HistoryError:
                await asyncio.sleep(RETRY_S)
                self._wake.set()

    async def flush(self) -> None:
        """Write the queued runs now.

        Raises:
            HistoryError: the database does not accept them; they stay queued.
        """
        await self._renew_if_moved()
        if not self._opened:
            await self.open()
        runs = list(self._pending.values())
        if runs:
            await self.record(runs)
        for run in runs:
            if self._pending.get(run.id) is run:
                del self._pending[run.id]

    async def record(self, runs: Sequence[Run]) -> None:
        """Insert or update runs. An ended run never becomes active again.

        Raises:
            HistoryError: the database does not accept them.
        """
        try:
            async with self._writing, self._sessions.begin() as session:
                for run in runs:
                    row = await session.get(RunRow, run.id)
                    if row is None:
                        session.add(_row(run))
                    elif row.state == RunState.ACTIVE or run.state is not RunState.ACTIVE:
                        await session.merge(_row(run))
        except SQLAlchemyError as error:
            raise HistoryError(self._note_failure(error)) from error
        self.problem = None

    async def newest(self, limit: int, before: str | None = None) -> list[Run]:
        """Return up to `limit` runs, newest first; if `before` is given, only runs older than that run.

        The order is the ledger's. Runs that were recorded before the ledger gave numbers follow by time of day.

        Raises:
            HistoryError: the database cannot be read.
            KeyError: there is no run `before`.
        """
        place = RunRow.seq, RunRow.requested_at, RunRow.id
        statement = select(RunRow).order_by(*(column.desc() for column in place)).limit(limit)
        async with self._reading() as session:
            if before is not None:
                edge = await session.get(RunRow, before)
                if edge is None:
                    raise KeyError(before)
                statement = statement.where(tuple_(*place) < tuple_(edge.seq, edge.requested_at, edge.id))
            rows = (await session.scalars(statement)).all()
        return [Run.model_validate(row.document) for row in rows]

    async def active(self) -> list[Run]:
        """Return the runs without an end.

        Raises:
            HistoryError: the database cannot be read.
        """
        async with self._reading() as session:
            rows = (await session.scalars(select(RunRow).where(RunRow.state == RunState.ACTIVE.value))).all()
        return [Run.model_validate(row.document) for row in rows]

    async def find(self, run_id: str) -> Run | None:
        """Return one run.

        Raises:
            HistoryError: the database cannot be read.
        """
        async with self._reading() as session:
            row = await session.get(RunRow, run_id)
        return None if row is None else Run.model_validate(row.document)

    @asynccontextmanager
    async def _reading(self) -> AsyncGenerator[AsyncSession]:
        try:
            async with self._sessions() as session:
                yield session
        except SQLAlchemyError as error:
            raise HistoryError(self._note_failure(error)) from error

    def _note_failure(self, error: Exception) -> str:
        cause = error.orig if isinstance(error, DBAPIError) else error
        problem = (
            f"The run history {self._path.name} cannot be used: {cause}. Free the disk, end what locks it, or move the "
            "file away: it is rebuilt from the control process's ledger."
        )
        if problem != self.problem:
            _log.error("history", problem=problem)
        self.problem = problem
        return problem


def _row(run: Run) -> RunRow:
    return RunRow(
        id=run.id,
        seq=run.seq,
        requested_at=run.requested_at,
        recipe=run.recipe,
        state=run.state.value,
        code=run.code.value if run.code else None,
        document=run.model_dump(mode="json"),
    )


def _number_runs(connection: Connection) -> None:
    """Bring the table of an older version up to date."""
    if "seq" not in {column["name"] for column in inspect(connection).get_columns(RunRow.__tablename__)}:
        connection.exec_driver_sql("ALTER TABLE runs ADD COLUMN seq INTEGER NOT NULL DEFAULT 0")
        connection.exec_driver_sql("CREATE INDEX runs_in_order ON runs (seq, requested_at, id)")


def _use_wal(connection: Any, _record: Any) -> None:
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA synchronous=NORMAL")
    cursor.close()

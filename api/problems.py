"""Errors as RFC 9457 problem details: one shape for every answer that is not a success."""

from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from service.client import CellRefusedError, CellSilentError
from service.faults import FaultCode
from service.messages import CellState, RefusalReason

MEDIA_TYPE = "application/problem+json"

SILENT_TEXT = (
    "The control process does not answer. The robot's state is not known here: "
    "if it may be moving, use the robot's own emergency stop."
)
INTERNAL_TEXT = "Internal error of this server. Its log has the trace under this request_id."

STATUS_OF_REASON: dict[RefusalReason, int] = {
    RefusalReason.INVALID_REQUEST: 422,
    RefusalReason.UNKNOWN_RECIPE: 422,
    RefusalReason.UNKNOWN_RUN: 404,
    RefusalReason.EXPIRED: 503,
    RefusalReason.STOPPED: 409,
    RefusalReason.WRONG_STATE: 409,
    RefusalReason.LATCHED: 409,
    RefusalReason.NOT_LATCHED: 409,
    RefusalReason.FORCE_ABOVE_LIMIT: 409,
    RefusalReason.NO_MEASUREMENT: 409,
    RefusalReason.POLICY_REFUSED: 422,
    RefusalReason.STORAGE: 503,
    RefusalReason.UNKNOWN_SENDER: 503,
    RefusalReason.REPLAYED: 409,
    RefusalReason.INTERNAL: 500,
}


class FieldError(BaseModel):
    """One refused field of a request."""

    location: str = Field(
        description="Location of the field, for example `body.recipe`, `query.limit` or `header.Idempotency-Key`."
    )
    message: str


class ProblemDetails(BaseModel):
    """RFC 9457 problem details, with the members that a client of a cell needs to decide on its next step."""

    type: str = Field("about:blank", description="`urn:dsl-assembly:problem:<reason>`, or `about:blank`.")
    title: str
    status: int
    detail: str = Field("", description="What is wrong, where, and what to do about it.")
    instance: str = Field("", description="Path of the request.")
    request_id: str | None = Field(None, description="Id of this request in the server's log lines.")
    reason: str | None = Field(None, description="Stable name of the reason, for programs.")
    code: FaultCode | None = Field(None, description="Fault in force, if any.")
    state: CellState | None = Field(None, description="State of the cell when it refused.")
    confirmed: bool | None = Field(None, description="False in the answer to a stop that was not delivered.")
    errors: list[FieldError] | None = Field(None, description="Fields that were refused.")


class ProblemError(Exception):
    """Raised by a handler to answer with a problem.

    Args:
        status: HTTP status.
        reason: stable name for programs, in capitals.
        detail: text for people.
        code: fault in force.
        state: state of the cell.
        field: location of the wrong field, if it is one.
        confirmed: False for a stop.
    """

    def __init__(
        self,
        status: int,
        reason: str,
        detail: str,
        *,
        code: FaultCode | None = None,
        state: CellState | None = None,
        field: str | None = None,
        confirmed: bool | None = None,
    ) -> None:
        super().__init__(detail)
        self.status, self.reason, self.detail = status, reason, detail
        self.code, self.state, self.confirmed = code, state, confirmed
        self.errors = [FieldError(location=field, message=detail)] if field else None


def problem_document(
    status: int, detail: str, *, instance: str = "", reason: str | None = None, **members: Any
) -> dict[str, Any]:
    """Return the JSON of one problem; members that are None are left out."""
    slug = reason.lower().replace("_", "-") if reason else None
    problem = ProblemDetails(
        type=f"urn:dsl-assembly:problem:{slug}" if slug else "about:blank",
        title=reason.replace("_", " ").capitalize() if reason else HTTPStatus(status).phrase,
        status=status,
        detail=detail,
        instance=instance,
        reason=reason,
        request_id=structlog.contextvars.get_contextvars().get("request_id"),
        **members,
    )
    return problem.model_dump(mode="json", exclude_none=True)


def problem_response(
    request: Request, status: int, detail: str, *, headers: Mapping[str, str] | None = None, **members: Any
) -> JSONResponse:
    document = problem_document(status, detail, instance=request.url.path, **members)
    return JSONResponse(document, status, headers=headers, media_type=MEDIA_TYPE)


def described(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return OpenAPI's `responses` for these statuses, each with an example."""
    return {
        status: {
            "description": HTTPStatus(status).phrase,
            "content": {
                MEDIA_TYPE: {
                    "schema": {"$ref": "#/components/schemas/ProblemDetails"},
                    "example": _EXAMPLES[status],
                }
            },
        }
        for status in statuses
    }


def install(app: FastAPI) -> None:
    """Answer every error of `app`, the framework's own included, with problem details."""

    async def on_problem(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, ProblemError)  # noqa: S101 - the registration below guarantees it
        return problem_response(
            request,
            error.status,
            error.detail,
            reason=error.reason,
            code=error.code,
            state=error.state,
            confirmed=error.confirmed,
            errors=error.errors,
        )

    async def on_refused(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, CellRefusedError)  # noqa: S101
        problem = error.problem
        return problem_response(
            request,
            STATUS_OF_REASON[problem.reason],
            problem.detail,
            reason=problem.reason.value,
            code=problem.code,
            state=problem.state,
            errors=[FieldError(location=f"body.{problem.field}", message=problem.detail)] if problem.field else None,
        )

    async def on_silent(request: Request, error: Exception) -> JSONResponse:
        return problem_response(request, 503, SILENT_TEXT, reason="CELL_SILENT", state=CellState.UNKNOWN)

    async def on_validation(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)  # noqa: S101
        errors = [
            FieldError(location=".".join(str(part) for part in item["loc"]), message=item["msg"])
            for item in error.errors()
        ]
        detail = "; ".join(f"{item.location}: {item.message}" for item in errors)
        return problem_response(request, 422, detail, reason="INVALID_REQUEST", errors=errors)

    async def on_http(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)  # noqa: S101
        return problem_response(request, error.status_code, error.detail, headers=error.headers)

    async def on_anything(request: Request, error: Exception) -> JSONResponse:
        structlog.get_logger().exception("unhandled", path=request.url.path)
        return problem_response(request, 500, INTERNAL_TEXT)

    app.add_exception_handler(ProblemError, on_problem)
    app.add_exception_handler(CellRefusedError, on_refused)
    app.add_exception_handler(CellSilentError, on_silent)
    app.add_exception_handler(RequestValidationError, on_validation)
    app.add_exception_handler(HTTPException, on_http)
    app.add_exception_handler(Exception, on_anything)


def _example(status: int, detail: str, reason: str | None = None, **members: Any) -> dict[str, Any]:
    return problem_document(status, detail, reason=reason, **members)


_EXAMPLES: dict[int, dict[str, Any]] = {
    403: _example(403, "This page may not command the cell: its origin is http://elsewhere.example.", "CROSS_SITE"),
    404: _example(404, "No run 7f3a in this cell's ledger.", "UNKNOWN_RUN"),
    409: _example(
        409,
        "The cell is latched by FORCE_CEILING: acknowledge it by POST /reset, then start again.",
        "LATCHED",
        code=FaultCode.FORCE_CEILING,
        state=CellState.LATCHED,
    ),
    413: _example(413, "The body is longer than 16384 bytes.", "BODY_TOO_LARGE"),
    421: _example(
        421, "Host 'elsewhere.example' is not a name of this cell; add it to allowed_hosts if it is.", "UNKNOWN_HOST"
    ),
    422: _example(
        422,
        "recipe 'cube' is not in this cell's configuration",
        "UNKNOWN_RECIPE",
        errors=[FieldError(location="body.recipe", message="recipe 'cube' is not in this cell's configuration")],
    ),
    500: _example(500, INTERNAL_TEXT),
    503: _example(503, SILENT_TEXT, "CELL_SILENT", state=CellState.UNKNOWN),
}

"""The service described, for programs and for people."""

from __future__ import annotations

import base64
import hashlib
import re
from importlib.resources import files
from typing import Any

from servoscope import __version__
from servoscope.service.answers import LARGEST_BODY

IMAGE_TYPES = ("image/png", "image/jpeg", "image/tiff", "image/bmp", "image/x-portable-graymap")

_NOTHING = ("default-src", "base-uri", "form-action", "frame-ancestors")


def openapi(size: tuple[int, int], needs_token: bool) -> dict[str, Any]:
    """The description of the service by OpenAPI 3.1.

    Parameters
    ----------
    size : tuple of 2 ints
        Width and height of the images that are taken, [px].
    needs_token : bool
    """
    width, height = size
    number = {"type": "number"}
    unknown = {"type": ["number", "null"]}
    row = {"type": "array", "items": number, "minItems": 4, "maxItems": 4}
    error = {
        "description": "What was wanted, what came, and what to do.",
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}},
    }
    estimate: dict[str, Any] = {
        "summary": "Where an image was taken",
        "operationId": "estimate",
        "requestBody": {
            "required": True,
            "description": f"The bytes of an image file, {width} x {height} px, up to "
            f"{LARGEST_BODY} bytes; colour is turned grey.",
            "content": {
                kind: {"schema": {"type": "string", "format": "binary"}} for kind in IMAGE_TYPES
            },
        },
        "responses": {
            "200": {
                "description": "What the model says of it.",
                "content": {
                    "application/json": {"schema": {"$ref": "#/components/schemas/Estimate"}}
                },
            },
            **dict.fromkeys(("400", "401", "403", "408", "411", "413", "422"), error),
        },
    }
    components: dict[str, Any] = {
        "schemas": {
            "Estimate": {
                "type": "object",
                "required": ["is_recognised", "displacement", "delta_p", "std"],
                "properties": {
                    "is_recognised": {
                        "type": "boolean",
                        "description": "If false, nothing else means anything: stop.",
                    },
                    "displacement": {
                        "type": "array",
                        "items": row,
                        "minItems": 4,
                        "maxItems": 4,
                        "description": "inv(T_world_ref) @ T_world_cam, row by row [m]. Moving by "
                        "its inverse in the frame's own axes brings the camera back.",
                    },
                    "delta_p": {
                        "type": "array",
                        "items": number,
                        "minItems": 6,
                        "maxItems": 6,
                        "description": "tx ty tz [m], rx ry rz [rad] about the pivot.",
                    },
                    "std": {
                        "type": "array",
                        "items": unknown,
                        "minItems": 6,
                        "maxItems": 6,
                        "description": "Standard deviation that is believed of each; null in dofs "
                        "that are not commanded.",
                    },
                    "similarity": unknown,
                    "least_similarity": number,
                    "novelty": unknown,
                    "seconds": number,
                },
            },
            "Error": {
                "type": "object",
                "required": ["error"],
                "properties": {"error": {"type": "string"}},
            },
        }
    }
    if needs_token:
        components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
        estimate["security"] = [{"token": []}]
    about = {"200": {"description": "What is served.", "content": {"application/json": {}}}}
    return {
        "openapi": "3.1.0",
        "info": {"title": "servoscope", "version": __version__},
        "paths": {
            "/estimate": {"post": estimate},
            "/health": {"get": {"summary": "Whether it runs", "responses": about}},
        },
        "components": components,
    }


def page() -> tuple[bytes, str]:
    """The page for people, and the policy that lets it run its own script and nothing else."""
    content = files("servoscope.service").joinpath("page.html").read_bytes()
    sources = []
    for tag in (b"script", b"style"):
        (own,) = re.findall(rb"<%b>(.*?)</%b>" % (tag, tag), content, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(own).digest()).decode()
        sources.append(f"{tag.decode()}-src 'sha256-{digest}'")
    policy = ["default-src 'none'", "connect-src 'self'", "img-src blob:", *sources]
    return content, "; ".join(
        [*policy, "base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"]
    )

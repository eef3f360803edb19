"""As much of JSON Schema (2020-12) as the exported schemas use; an unknown keyword is an error."""

import re
from collections.abc import Mapping
from typing import Any

TYPES: Mapping[str, Any] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "null": type(None),
    "integer": int,
    "number": (int, float),
}
SAID_ELSEWHERE = {"$schema", "title", "description", "default", "properties", "prefixItems"}


def violations(value: Any, schema: Mapping[str, Any], at: str = "$") -> list[str]:
    """What is wrong with `value`, each with its place; empty if nothing is."""
    found = _checked("type", schema["type"], value, schema, at) if "type" in schema else []
    if found:
        return found
    for keyword, wanted in schema.items():
        if keyword not in SAID_ELSEWHERE:
            found += _checked(keyword, wanted, value, schema, at)
    if isinstance(value, dict):
        for name, part in schema.get("properties", {}).items():
            if name in value:
                found += violations(value[name], part, f"{at}.{name}")
    if isinstance(value, list):
        for k, part in enumerate(schema.get("prefixItems", [])[: len(value)]):
            found += violations(value[k], part, f"{at}[{k}]")
    return found


def _checked(keyword: str, wanted: Any, value: Any, schema: Mapping[str, Any], at: str) -> list[str]:  # noqa: PLR0911, PLR0912
    wrong: list[str] = [f"{at}: {value!r} breaks {keyword} {wanted!r}"]
    match keyword:
        case "type":
            same = isinstance(value, TYPES[wanted])
            if isinstance(value, bool) and wanted in ("integer", "number"):
                same = False
            return [] if same else wrong
        case "const":
            return [] if value == wanted else wrong
        case "enum":
            return [] if value in wanted else wrong
        case "required":
            return [f"{at}: no {name!r}" for name in wanted if name not in value]
        case "additionalProperties" if wanted is False:
            return [f"{at}: unknown {name!r}" for name in value if name not in schema.get("properties", {})]
        case "additionalProperties":
            others = [name for name in value if name not in schema.get("properties", {})]
            return [line for name in others for line in violations(value[name], wanted, f"{at}.{name}")]
        case "anyOf":
            return [] if any(not violations(value, option, at) for option in wanted) else wrong
        case "items":
            first = len(schema.get("prefixItems", []))
            return [line for k, v in enumerate(value[first:]) for line in violations(v, wanted, f"{at}[{k}]")]
        case "minItems" | "minLength":
            return [] if len(value) >= wanted else wrong
        case "maxItems" | "maxLength":
            return [] if len(value) <= wanted else wrong
        case "minimum":
            return [] if value >= wanted else wrong
        case "maximum":
            return [] if value <= wanted else wrong
        case "exclusiveMinimum":
            return [] if value > wanted else wrong
        case "pattern":
            return [] if re.search(wanted, value) else wrong
    raise NotImplementedError(f"{at}: schema keyword {keyword!r}")

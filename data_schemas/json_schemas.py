"""JSON Schema of every stored record (generated; ``make schemas`` writes ``data_schemas/json_schema/``)."""

import json
from pathlib import Path
from typing import Any

from data_schemas import (
    AcceptanceReport,
    BandFolder,
    BandSignals,
    CameraCharacterisation,
    CameraPlan,
    CameraSession,
    CaptureSession,
    CertificateDetails,
    CheckPlan,
    ComparisonBatch,
    DatasetShard,
    DesignOptimum,
    DesignStudy,
    EvaluatedDesign,
    FingerDesign,
    FingerStiffness,
    FingerSurfaces,
    FingerTolerances,
    FluorescentRendering,
    ForceComparison,
    LearningDataset,
    LightAngleDecision,
    LightAngleIntensity,
    LightAngleSweep,
    LightPowers,
    LoadCellCalibration,
    MaterialFit,
    NormalMapRecord,
    ObjectGrasp,
    PaintCalibration,
    PaintChoice,
    PaintMap,
    PaintPlan,
    PaintWithoutEmission,
    PaperPaints,
    PhotometricErrorReport,
    PixelScale,
    PixelSignals,
    PlainSensor,
    PressIncrement,
    PressMechanics,
    PressSurrogate,
    Record,
    RigFile,
    SensedPress,
    SensorFit,
    SimulatedPress,
    StudyPoint,
    StudyResult,
    TactileCapture,
    TactileCheckPlan,
    TactilePlan,
    TactileRig,
    TactileSession,
    TaughtPress,
    TwoLights,
)

FOLDER = Path(__file__).resolve().parent / "json_schema"
WRITTEN_BY_PEOPLE: tuple[type[Record], ...] = (
    RigFile,
    TactileRig,
    PaintPlan,
    BandFolder,
    CameraPlan,
    TactilePlan,
    CheckPlan,
    TactileCheckPlan,
    CertificateDetails,
    FingerDesign,
    PlainSensor,
    DesignStudy,
)
STORED: tuple[type[Record], ...] = (
    CaptureSession,
    CameraSession,
    CameraCharacterisation,
    TactileSession,
    TactileCapture,
    LoadCellCalibration,
    BandSignals,
    PixelSignals,
    PaintCalibration,
    PaintWithoutEmission,
    PaintMap,
    PaperPaints,
    FingerStiffness,
    PressIncrement,
    PressMechanics,
    PressSurrogate,
    TaughtPress,
    ObjectGrasp,
    ForceComparison,
    MaterialFit,
    FingerSurfaces,
    SensedPress,
    SensorFit,
    SimulatedPress,
    LightAngleSweep,
    FluorescentRendering,
    TwoLights,
    LightAngleIntensity,
    NormalMapRecord,
    PixelScale,
    PhotometricErrorReport,
    ComparisonBatch,
    LightAngleDecision,
    AcceptanceReport,
    StudyPoint,
    StudyResult,
    FingerTolerances,
    LightPowers,
    PaintChoice,
    EvaluatedDesign,
    DesignOptimum,
    DatasetShard,
    LearningDataset,
)


def json_schema(record_type: type[Record]) -> dict[str, Any]:
    """Return the JSON Schema of a stored record (with its envelope) or of a file a person writes."""
    schema = record_type.model_json_schema(mode="validation")
    if record_type in WRITTEN_BY_PEOPLE:
        return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    definitions = schema.pop("$defs", {})
    array_file = {
        "type": "object",
        "properties": {"file": {"type": "string"}, "sha256": {"type": "string", "pattern": "^[0-9a-f]{64}$"}},
        "required": ["file", "sha256"],
        "additionalProperties": False,
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"{record_type.__name__} (stored record)",
        "type": "object",
        "properties": {
            "kind": {"const": record_type.__name__},
            "schema_version": {"const": record_type.schema_version},
            "array_file": {"anyOf": [array_file, {"type": "null"}]},
            "companions": {
                "type": "object",
                "description": "file stored together with the record, from its folder -> SHA-256 (pages, pictures)",
                "additionalProperties": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
            },
            "record": schema,
            "content_sha256": {
                "type": "string",
                "pattern": "^[0-9a-f]{64}$",
                "description": "seal: SHA-256 of all others as canonical JSON (sorted keys, no spaces, UTF-8)",
            },
        },
        "required": ["kind", "schema_version", "array_file", "record", "content_sha256"],
        "additionalProperties": False,
        "$defs": definitions,
    }


def schema_text(record_type: type[Record]) -> str:
    """Return the text of the schema file of a record."""
    return json.dumps(json_schema(record_type), indent=1, ensure_ascii=False) + "\n"


def main() -> None:
    """Write all schema files."""
    FOLDER.mkdir(exist_ok=True)
    for record_type in (*WRITTEN_BY_PEOPLE, *STORED):
        (FOLDER / f"{record_type.__name__}.schema.json").write_text(schema_text(record_type), encoding="utf-8")


if __name__ == "__main__":
    main()

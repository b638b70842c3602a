"""The only reader and writer of records, and the only reader of all other files.

Files are stored atomically (complete or absent, never overwritten), with a seal (SHA-256 of the envelope) and a version
(files of earlier versions are migrated as they are read). Several files are committed together: a `ProductSet` is valid
once its last file has its name. Files of other programs are read by `read_bytes` and `open_regular`: limits are checked
before anything is parsed, the bytes are hashed as they are read, and parsers that may crash run in a child process with
limits of time and memory.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from data_schemas.storage._array_files import (
        FIRST_RED,
        LARGEST_DECODED_BYTES,
        BayerOrder,
        parse_in_child,
        read_frame,
        read_npy,
        read_npz,
        require_decoded_size,
        rggb_frame,
        tiff_image,
        write_frame,
    )
    from data_schemas.storage._child_process import (
        OBJECTS_PER_COLLECTION,
        Child,
        call_in_child,
        is_child,
        memory_left,
        progress_sender,
        stopping_together,
        tell,
    )
    from data_schemas.storage._curve_files import (
        assumed_camera_response,
        camera_response,
        halogen_lamp,
        lamp_curve,
        planck_relative,
        read_camera_response,
        read_donaldson_matrix,
        read_filter_curve,
        read_filter_curves,
        read_light,
        read_table,
    )
    from data_schemas.storage._foreign_files import (
        LARGEST_TEXT_BYTES,
        LARGEST_TOML_BYTES,
        digest_as_read,
        files_below,
        files_in,
        finite_number,
        folder_at,
        has_file,
        open_regular,
        parse_json,
        read_bytes,
        read_csv,
        read_json,
        read_text,
        read_toml_tables,
    )
    from data_schemas.storage._product_set import (
        MANIFEST_NAME,
        FileFault,
        FileState,
        ProductSet,
        clear_leftovers,
        manifest_faults,
        manifest_text,
        write_manifest,
    )
    from data_schemas.storage._records import (
        A_RECORD,
        migrate,
        read_record,
        read_toml,
        stored_kind,
        toml_text,
        write_record,
    )
    from data_schemas.storage._whole_files import (
        given_path,
        lock,
        refuse_existing,
        sha256_of,
        write_atomically,
        write_bytes,
        write_zip,
        writing,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "A_RECORD",
    "FIRST_RED",
    "LARGEST_DECODED_BYTES",
    "LARGEST_TEXT_BYTES",
    "LARGEST_TOML_BYTES",
    "MANIFEST_NAME",
    "OBJECTS_PER_COLLECTION",
    "BayerOrder",
    "Child",
    "FileFault",
    "FileState",
    "ProductSet",
    "assumed_camera_response",
    "call_in_child",
    "camera_response",
    "clear_leftovers",
    "digest_as_read",
    "files_below",
    "files_in",
    "finite_number",
    "folder_at",
    "given_path",
    "halogen_lamp",
    "has_file",
    "is_child",
    "lamp_curve",
    "lock",
    "manifest_faults",
    "manifest_text",
    "memory_left",
    "migrate",
    "open_regular",
    "parse_in_child",
    "parse_json",
    "planck_relative",
    "progress_sender",
    "read_bytes",
    "read_camera_response",
    "read_csv",
    "read_donaldson_matrix",
    "read_filter_curve",
    "read_filter_curves",
    "read_frame",
    "read_json",
    "read_light",
    "read_npy",
    "read_npz",
    "read_record",
    "read_table",
    "read_text",
    "read_toml",
    "read_toml_tables",
    "refuse_existing",
    "require_decoded_size",
    "rggb_frame",
    "sha256_of",
    "stopping_together",
    "stored_kind",
    "tell",
    "tiff_image",
    "toml_text",
    "write_atomically",
    "write_bytes",
    "write_frame",
    "write_manifest",
    "write_record",
    "write_zip",
    "writing",
]

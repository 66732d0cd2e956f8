from ._inbox import (
    MOST_PX as MOST_PX,
    PHOTOGRAPHS_FOLDER as PHOTOGRAPHS_FOLDER,
    ArrivedPhotograph as ArrivedPhotograph,
    ImportRequest as ImportRequest,
    PhotographInbox as PhotographInbox,
    import_arrived as import_arrived,
    photograph_file as photograph_file,
)
from ._jpeg import (
    JpegError as JpegError,
    jpeg_size as jpeg_size,
    without_location as without_location,
)
from ._receiving import (
    SENDING_FOLDER as SENDING_FOLDER,
    Receiver as Receiver,
    number_of as number_of,
    text_of as text_of,
    told_fault as told_fault,
)
from ._uploads import (
    PART_BYTES as PART_BYTES,
    Received as Received,
    TryAgainError as TryAgainError,
    UploadError as UploadError,
    Uploads as Uploads,
)

from .axis import open_zaber_stage as open_zaber_stage
from .wire import checksum as checksum, parse_message as parse_message

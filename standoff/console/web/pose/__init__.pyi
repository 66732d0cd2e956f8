from .pose_commands import pose_commands as pose_commands
from .pose_pages import PosePages as PosePages
from .pose_state import pose_document as pose_document, pose_state as pose_state

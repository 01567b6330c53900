"""A scene as it shows itself in a notebook."""

import base64
import html
import io

from instok3d.scene.object_pictures import object_picture
from instok3d.scene.previews import scene_sheet
from instok3d.scene.scene import Scene

MOST_OBJECTS = 48
"""Objects on the sheet, those with the most Gaussians; drawing thousands would take minutes."""


def scene_html(scene: Scene) -> str:
    """What the scene holds in one line, and its contact sheet as a picture inside the text."""
    largest = sorted(scene.objects, key=lambda item: -item.num_gaussians)[:MOST_OBJECTS]
    shown = [item for item in scene.objects if item in largest]
    stream = io.BytesIO()
    sheet = scene_sheet(scene, shown, [object_picture(scene, item) for item in shown])
    sheet.convert("RGB").save(stream, "JPEG", quality=85)
    picture = base64.b64encode(stream.getvalue()).decode("ascii")
    more = len(scene.objects) - len(shown)
    note = f"<p>{more} smaller objects are not on the sheet.</p>" if more else ""
    return (
        f"<p><code>{html.escape(repr(scene))}</code></p>{note}"
        f'<img alt="contact sheet of the scene" style="max-width: 100%" '
        f'src="data:image/jpeg;base64,{picture}">'
    )

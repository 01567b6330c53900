"""The panel beside the picture: what is selected, what can be done, the list of objects.

Labels come from files, and a panel's HTML is not escaped by viser: every text goes through
`escape`. Widgets show their labels as text.
"""

from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Any

from instok3d.formats.registry import writable
from instok3d.scene.edits.disclosure import edited_words
from instok3d.scene.objects import SceneObject
from instok3d.scene.scene import Scene
from instok3d.viewer.session import Session
from instok3d.viewer.uploads import accepted, shown_name, taken_from, uploaded_scene
from instok3d.webpage.page import size_words, thumbnail

if TYPE_CHECKING:
    import viser

NONE: str = "none"
LISTED = 200
"""Objects in the list, those with the most Gaussians; the others are selected in the picture."""


class Panel:
    """The widgets of a server; `show` brings them up to date.

    Each does one thing by a function of `do`, which takes the name of what is done and a function
    without arguments, and shows what went wrong.
    """

    def __init__(
        self,
        server: "viser.ViserServer",
        session: Session,
        *,
        do: Callable[[Callable[[], object], Any], None],
        stand_at: Callable[[int, Any], None],
        compare: Callable[[int], Any],
        show_photos: Callable[[bool], None],
        use_gizmo: Callable[[bool], None],
        export: Callable[[str, bool, Any], None],
        upload_limit_bytes: int = 0,
    ) -> None:
        """Add the widgets.

        Args:
            server: Without widgets.
            session: What they show and change.
            do: Runs one change for a client, brings everything up to date, and says what failed.
            stand_at: Takes a client to a photo.
            compare: Picture of a photo beside the scene at its camera.
            show_photos: Shows the photos' cameras, or hides them.
            use_gizmo: Puts the gizmo on what is selected, or takes it away.
            export: Sends a client a file of this ending, of what is selected alone if so wanted.
            upload_limit_bytes: Of a file to insert from; 0: none can be sent.
        """
        self._gui, self._session, self._do = server.gui, session, do
        self._thumbnails: dict[tuple[int, int], str] = {}
        self._rows: dict[int, tuple[Any, Any]] = {}
        self._gui.configure_theme(dark_mode=True, show_share_button=False, control_width="large")
        self._about = self._gui.add_html("")
        self._undo, self._redo = (
            self._button("Undo", session.undo),
            self._button("Redo", session.redo),
        )
        if session.can_search:
            self._add_search()
        self._add_edits(use_gizmo)
        if session.others or upload_limit_bytes:
            self._add_insertion(upload_limit_bytes)
        if session.scene.views:
            self._add_photos(stand_at, compare, show_photos)
        self._add_output(export)
        self._folder = self._gui.add_folder("Objects")
        with self._folder:
            colors = self._gui.add_checkbox("Colour by object", False)
            colors.on_update(lambda event: do(
                lambda: session.color_instances(event.target.value), event.client
            ))  # fmt: skip
        self.show()

    def show(self) -> None:
        """Bring the widgets up to date."""
        session, scene = self._session, self._session.scene
        self._about.content = about(scene)
        self._undo.disabled, self._redo.disabled = not session.can_undo, not session.can_redo
        self._chosen.content = (
            "".join(
                row(scene, item, self._thumbnail(item), named=True) for item in session.selected
            )
            or "<p>Click an object in the picture, or tick it in the list. Ctrl-click adds one.</p>"
        )
        largest = sorted(scene.objects, key=lambda item: -item.num_gaussians)[:LISTED]
        wanted = {item.id for item in largest} | session.shown.selected
        for number in set(self._rows) - wanted:
            for widget in self._rows.pop(number):
                widget.remove()
        for item in scene.objects:
            if item.id in wanted:
                self._show_row(item)
        touching = tuple(session.touching())  # last: it may take a moment
        self._neighbour.options, self._neighbour.disabled = touching or (NONE,), not touching

    def _show_row(self, item: SceneObject) -> None:
        selected = item.id in self._session.shown.selected
        content = row(self._session.scene, item, self._thumbnail(item))
        if item.id not in self._rows:
            place = 2 * item.id + (1e9 if item.is_fragment else 1e3)
            with self._folder:
                picture = self._gui.add_html(content, order=place)
                tick = self._gui.add_checkbox(item.key, selected, order=place + 1)
            tick.on_update(lambda event: self._ticked(item.id, event))
            self._rows[item.id] = picture, tick
            return
        picture, tick = self._rows[item.id]
        picture.content, tick.label, tick.value = content, item.key, selected

    def _ticked(self, number: int, event: Any) -> None:
        """A tick by a person; one by `show`, without a client, is what the session has.

        It is not asked for its value, which `show` may have set since.
        """
        if event.client is not None:
            self._do(lambda: self._session.toggle(number), event.client)

    def _thumbnail(self, item: SceneObject) -> str:
        key = item.id, item.num_gaussians
        if key not in self._thumbnails:
            self._thumbnails[key] = thumbnail(self._session.scene, item)
        return self._thumbnails[key]

    def _button(self, label: str, operation: Callable[[], object], hint: str | None = None) -> Any:
        button = self._gui.add_button(label, hint=hint)
        button.on_click(lambda event: self._do(operation, event.client))
        return button

    def _buttons(self, label: str, operations: dict[str, Callable[[], object]]) -> None:
        """Buttons side by side."""
        group = self._gui.add_button_group(label, tuple(operations))
        group.on_click(lambda event: self._do(operations[event.target.value], event.client))

    def _add_search(self) -> None:
        """A box that selects what words mean, and says how they were understood."""
        with self._gui.add_folder("Search"):
            asked = self._gui.add_text(
                "Find", "", hint="the red chair; all lamps; largest table; lamp on the desk"
            )
            said = self._gui.add_html("")

            def find() -> None:
                said.content = ""
                said.content = f"<p style='padding: 0 .75em'>{escape(search(asked.value))}</p>"

            search = self._session.search
            self._button("Search", find)

    def _add_edits(self, use_gizmo: Callable[[bool], None]) -> None:
        session = self._session
        with self._gui.add_folder("Selected"):
            self._chosen = self._gui.add_html("")
            gizmo = self._gui.add_checkbox("Move by hand", False)
            gizmo.on_update(lambda event: self._do(
                lambda: use_gizmo(event.target.value), event.client
            ))  # fmt: skip
            turn = self._gui.add_number("Turn (degrees)", 30.0, min=-360.0, max=360.0)
            self._button("Turn about up", lambda: session.turn(turn.value))
            self._buttons("In the picture", {"Hide": session.hide, "Show": session.show})
            fill = self._gui.add_checkbox(
                "Fill the hole", False, hint="Of what is removed, by floors and walls: invented"
            )
            self._buttons("Object", {
                "Remove": lambda: session.remove(fill=fill.value), "Duplicate": session.duplicate
            })  # fmt: skip
            self._buttons("Objects", {"Merge": session.merge, "Split": session.split})
            self._neighbour = self._gui.add_dropdown("Touches", (NONE,), disabled=True)
            self._button(
                "Merge with it",
                lambda: session.merge_with(session.touching().get(self._neighbour.value)),
                "With the neighbour above: a chair's base may be a part of another object",
            )
            label = self._gui.add_text("Name", "")
            self._button("Rename", lambda: session.rename(label.value))

    def _add_insertion(self, upload_limit_bytes: int) -> None:
        session = self._session
        with self._gui.add_folder("Insert"):
            other = self._gui.add_dropdown("From", tuple(session.others) or (NONE,))
            which = self._gui.add_dropdown("Object", (NONE,))

            def show_objects() -> None:
                if other.value in session.others:
                    which.options = keys_of(session.others[other.value])

            show_objects()
            other.on_update(lambda _: show_objects())

            def add(file: Any) -> None:
                scene = uploaded_scene(file.name, file.content, upload_limit_bytes)
                name = session.add_other(shown_name(file.name), scene)
                other.options, other.value = tuple(session.others), name
                show_objects()

            if upload_limit_bytes:
                send = self._gui.add_upload_button(
                    "Add a file", mime_type=accepted(),
                    hint=f"Gaussians, or a zipped scene folder, up to {upload_limit_bytes:,} bytes",
                )  # fmt: skip
                send.on_upload(lambda event: self._do(
                    lambda: add(taken_from(event.target)), event.client
                ))  # fmt: skip
            self._button(
                "Insert where clicked", lambda: session.insert(other.value, which.value),
                "It stands on the object that was clicked last",
            )  # fmt: skip

    def _add_photos(
        self,
        stand_at: Callable[[int, Any], None],
        compare: Callable[[int], Any],
        show_photos: Callable[[bool], None],
    ) -> None:
        views = self._session.scene.views
        folder = self._gui.add_folder("Photos")
        with folder:
            names = tuple(f"{index}: {view.file}" for index, view in enumerate(views))
            photo = self._gui.add_dropdown("Photo", names)
            stand = self._gui.add_button("Stand there")
            stand.on_click(lambda event: stand_at(names.index(photo.value), event.client))
            shown = self._gui.add_checkbox("Show cameras", False)
            shown.on_update(lambda event: show_photos(event.target.value))
            look = self._gui.add_button("Compare with photo")
            pictures: list[Any] = []

            @look.on_click
            def _(_: object) -> None:
                picture = compare(names.index(photo.value))
                if pictures:
                    pictures[0].image = picture
                    return
                with folder:
                    pictures.append(
                        self._gui.add_image(picture, label="photo | scene at its camera")
                    )

    def _add_output(self, export: Callable[[str, bool, Any], None]) -> None:
        with self._gui.add_folder("Save", expand_by_default=False):
            if self._session.has_folder:
                name = self._gui.add_text("Name", "edited.itk")
                self._button("Save as", lambda: self._session.save_as(name.value))
            ending = self._gui.add_dropdown("Format", writable())
            alone = self._gui.add_checkbox("Selected objects alone", False)
            send = self._gui.add_button("Download")
            send.on_click(lambda event: export(ending.value, alone.value, event.client))


def about(scene: Scene) -> str:
    """A scene in a few words, as HTML."""
    lines = [
        f"{len(scene.objects)} objects, {len(scene.gaussians.means)} Gaussians",
        "lengths in metres" if scene.units == "metres" else "lengths in arbitrary units",
        *([edited_words(scene)] if scene.edits else []),
        *scene.edits[-1:],
    ]
    return f"<p style='padding: 0 .75em'>{'<br>'.join(escape(line) for line in lines)}</p>"


def row(scene: Scene, item: SceneObject, picture: str, *, named: bool = False) -> str:
    """Thumbnail, colour and size of an object, as HTML."""
    words = [size_words(scene, item), f"{item.num_gaussians} Gaussians"]
    words = [item.key, *words] if named else words
    words += ["hidden"] if item.hidden else []
    return (
        f"<div style='display: flex; gap: .75em; padding: .25em .75em; align-items: center'>"
        f"<img alt='' height='48' style='border: 3px solid {item.color}' src='{escape(picture)}'>"
        f"<span>{'<br>'.join(escape(each) for each in words)}</span></div>"
    )


def keys_of(scene: Scene) -> tuple[str, ...]:
    """Keys of the objects, for a list to choose from."""
    return tuple(item.key for item in scene.objects) or (NONE,)

"""The page's loop: what visitors do goes to ROS, what ROS says goes to the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import queue
import secrets
import time
from typing import Any

import numpy as np
from rclpy.executors import Executor
import viser

from redundant_planner.core.errors import ObstacleError, PlannerError
from redundant_planner.io.tip_topics import OBJECT
from redundant_planner.playground.drive import DeadMan, twist_of
from redundant_planner.playground.drive_controls import DriveControls
from redundant_planner.playground.item_controls import ItemControls
from redundant_planner.playground.items_view import ItemsView, moved, OthersView
from redundant_planner.playground.more_controls import Granted, MoreControls
from redundant_planner.playground.obstacle_sender import ObstacleSender
from redundant_planner.playground.page_server import PageServer
from redundant_planner.playground.planner_client import PlannerClient
from redundant_planner.playground.recordings import Recordings
from redundant_planner.playground.scene_nodes import SceneNodes
from redundant_planner.playground.scenes import ArmSetup, PageScene
from redundant_planner.playground.shown_arm import ShownArm
from redundant_planner.playground.world import Item, Numbers, World

# How often figures are written [s], and how many wishes of visitors one turn of the loop grants.
_FIGURES, _MOST_WISHES = 0.2, 500
# Where a new obstacle appears [m].
_PLACE = (0.35, -0.35, 0.55)


@dataclass(frozen=True)
class Options:
    """What the page may do.

    Attributes:
        planner: name of the planners' nodes.
        drives: whether anything is ever told to them.
        stops_at_release: whether letting go of the handle stops the arm, at first.
        arms: namespaces of the arms, where the page does not run them.
        recordings: folder for bags and reports.
    """

    planner: str
    drives: bool
    stops_at_release: bool
    arms: tuple[str, ...]
    recordings: Path


@dataclass
class _Driver:
    """The visitor who drives."""

    client: viser.ClientHandle
    token: str
    drive: DriveControls | None = None
    items: ItemControls | None = None
    more: MoreControls | None = None


class Playground:
    """The page. `turn` is one turn of its loop; all else that changes it waits for that."""

    def __init__(
        self, executor: Executor, server: viser.ViserServer, options: Options,
        scenes: Sequence[PageScene], nodes: SceneNodes | None, environment: dict[str, str],
    ) -> None:
        """Prepare the page.

        Args:
            executor: spins its nodes.
            server: viser's.
            options: what the page may do.
            scenes: to choose from.
            nodes: that make a scene; None where somebody else runs planner and arm.
            environment: for processes that record.
        """
        self._executor, self._server, self._options = executor, server, options
        self._scenes, self._nodes = tuple(scenes), nodes
        self._wishes: queue.SimpleQueue[tuple[Callable[..., object], tuple[Any, ...]]] = (
            queue.SimpleQueue())
        self._world, self._dead_man = World(), DeadMan()
        self._driver: _Driver | None = None
        self._visitors: list[viser.ClientHandle] = []
        self._driven, self._dragged_item = 0, ''
        self._arms: list[ShownArm] = []
        self._sender: ObstacleSender | None = None
        self._recordings = Recordings(options.recordings, environment)
        self._begin, self._written, self._notice = time.monotonic(), -math.inf, ''
        self._page: PageServer | None = None
        self._scene: PageScene | None = None
        self._set_up()
        if nodes is None:
            self._listen_to([ArmSetup({}, namespace=name) for name in options.arms])
        else:
            self.load(self._scenes[0])

    def _set_up(self) -> None:
        """Prepare what all visitors see."""
        server = self._server
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width='large', dark_mode=False)
        server.scene.add_grid('/floor', width=4.0, height=4.0, cell_size=0.1, section_size=0.5,
                              cell_color=(225, 225, 228), section_color=(190, 190, 196))
        # Both take a computer without graphics five times as long to draw.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_hemisphere('/sky', ground_color=(190, 190, 200), intensity=2.0)
        server.initial_camera.position = (1.45, -1.15, 1.05)
        server.initial_camera.look_at = (0.25, 0.0, 0.4)
        with server.gui.add_folder('Now', order=1.2):
            self._figures = server.gui.add_html('')
        self._items_view = ItemsView(
            server.scene, lambda *drag: self._if_drives(self._drag_item, *drag),
            lambda *click: self._if_drives(self._click_item, *click))
        self._others_view = OthersView(server.scene)

        async def comes(client: viser.ClientHandle) -> None:
            self._later(self._visitor_comes, client)

        async def goes(client: viser.ClientHandle) -> None:
            self._later(self._visitor_goes, client)

        server.on_client_connect(comes)
        server.on_client_disconnect(goes)

    def serve(self, host: str, port: int) -> str:
        """Serve the page; return where to open it.

        Raises:
            PlannerError: as `PageServer`.
        """
        self._page = PageServer(host, port, self._server.get_port())
        self._page.reports = self._recordings.reports
        return self._page.url

    def close(self) -> None:
        """End what the page has begun; an arm that it drives is told to stop."""
        if self._driver is not None and self._arms:
            self._arms[self._driven].client.send_twist(np.zeros(6))
        self._recordings.close()
        if self._page is not None:
            self._page.close()

    def _later(self, wish: Callable[..., object], *arguments: Any) -> None:
        self._wishes.put((wish, arguments))

    def _if_drives(self, wish: Callable[..., object], client_id: int, *arguments: Any) -> None:
        """Grant a wish of the driver's later; a watcher's is dropped here, and never waits."""
        if self._is_driver(client_id):
            self._later(wish, client_id, *arguments)

    # The loop.

    def turn(self) -> None:
        """Take one turn: grant wishes, command, hear and draw."""
        now = time.monotonic()
        for _ in range(_MOST_WISHES):
            try:
                wish, arguments = self._wishes.get_nowait()
            except queue.Empty:
                break
            try:
                wish(*arguments)
            except PlannerError as error:
                self._notice = str(error)
        if self._nodes is not None:
            self._nodes.check()
        self._command()
        time_of_things = now - self._begin
        if self._sender is not None and self._frame:
            topics = {arm.client.obstacle_topic for arm in self._arms} - {''}
            self._sender.send(self._world.items, topics, self._frame, time_of_things)
        for arm in self._arms:
            arm.look(now)
        items = self._world.items
        chosen = ''
        if self._driver is not None and self._driver.items is not None:
            self._driver.items.show(time_of_things, self._dragged_item)
            chosen = self._driver.items.chosen
        self._items_view.show(items, chosen, time_of_things)
        if self._arms:
            arms = {arm.client.namespace.strip('/') for arm in self._arms}
            self._others_view.show(self._arms[0].client.scene, frozenset(items) | arms)
        if now - self._written >= _FIGURES:
            self._written = now
            self._write_figures()

    @property
    def _frame(self) -> str:
        """The frame that all is given in; empty while no robot is known."""
        robot = self._arms[0].client.robot if self._arms else None
        return '' if robot is None else robot.base_frame

    def _command(self) -> None:
        """Send what the driver asks for."""
        driver = self._driver
        if driver is None or driver.drive is None or not self._arms:
            return
        held = self._page.take() if self._page is not None else None
        now = time.monotonic()  # all else in this turn may have taken long
        if held is not None:
            wanted = twist_of(held, driver.drive.speeds, driver.drive.sliders)
            if wanted is None:
                self._dead_man.let_go(now)
            else:
                self._dead_man.hold(wanted, held.at)
        shown = self._arms[self._driven]
        driver.drive.offer(shown.client.tips)
        places = {} if shown.arm is None else shown.client.places(shown.arm)
        targets, released = driver.drive.take()
        if released and driver.drive.stops_at_release:
            self._dead_man.stop(now)
        else:
            for name, target in targets.items():
                shown.client.send_target(target, name)
        twist = self._dead_man.twist(now)
        if twist is not None:
            shown.client.send_twist(twist, OBJECT if OBJECT in places else driver.drive.tip)
        driver.drive.follow(places, {
            name for name in places if name in targets or shown.client.is_aimed(name)})

    def _write_figures(self) -> None:
        """Write what is known now for all to see."""
        self._recordings.look()
        if self._driver is not None and self._driver.more is not None:
            self._driver.more.show_recordings(self._recordings)
        shown = self._arms[self._driven] if self._arms else None
        words = [self._notice]
        if shown is not None:
            words += [shown.says, shown.client.trouble]
            if not shown.client.is_there:
                words.append('the planner and the arm are starting' if self._nodes is not None
                             else 'no arm is heard')
        notes = ''.join(f'<div style="padding:0 .6em;font-size:12px" data-notice>{_plain(word)}'
                        '</div>' for word in words if word)
        content = notes + (shown.figures if shown is not None else '')
        if self._figures.content != content:
            self._figures.content = content

    # Visitors.

    def _visitor_comes(self, client: viser.ClientHandle) -> None:
        self._visitors.append(client)
        if self._driver is None:
            self._make_driver(client)
        elif self._options.drives:
            client.gui.add_markdown(
                '**Somebody else drives this arm; you watch.** You drive when they close their '
                'page.', order=0)

    def _visitor_goes(self, client: viser.ClientHandle) -> None:
        self._visitors = [one for one in self._visitors if one.client_id != client.client_id]
        if self._driver is None or self._driver.client.client_id != client.client_id:
            return
        self._dead_man.stop(time.monotonic())
        if self._arms:
            self._arms[self._driven].client.send_twist(np.zeros(6))
        self._driver, self._dragged_item = None, ''
        if self._page is not None:
            self._page.admit('')
        if self._visitors:
            self._visitors[0].gui.reset()
            self._make_driver(self._visitors[0])

    def _make_driver(self, client: viser.ClientHandle) -> None:
        """Give a visitor the controls."""
        driver = _Driver(client, secrets.token_urlsafe(8))
        driver.more = MoreControls(
            client, self._later, self._scenes, self._scene,
            [arm.client.namespace.strip('/') for arm in self._arms],
            Granted(self.load, self._drive, self._compare, self._record, self._show))
        if self._options.drives:
            if self._page is not None:
                self._page.admit(driver.token)
            client.gui.add_html(
                f'<span hidden data-playground-token="{driver.token}"></span>', order=0)
            driver.drive = DriveControls(
                client, self._later, stops_at_release=self._options.stops_at_release,
                stop=self._stop, pause=self._pause, reset=self._reset, couple=self._couple)
            driver.items = ItemControls(
                client, self._world, self._later, self._add, self._world.change)
        self._driver = driver

    def _is_driver(self, client_id: int) -> bool:
        driver = self._driver
        return (driver is not None and driver.drive is not None
                and driver.client.client_id == client_id)

    # What the driver may do.

    def _stop(self) -> None:
        self._dead_man.stop(time.monotonic())

    def _pause(self, paused: bool) -> None:
        self._arms[self._driven].client.pause(paused)

    def _couple(self, together: bool) -> None:
        self._arms[self._driven].client.couple(together)

    def _reset(self) -> None:
        self._arms[self._driven].client.reset()
        for arm in self._arms:
            arm.forget()

    def _drive(self, number: int) -> None:
        """Drive another arm; the one before comes to rest."""
        self._arms[self._driven].client.send_twist(np.zeros(6))
        self._dead_man = DeadMan()
        self._driven = min(number, len(self._arms) - 1)

    def _add(self, shape: str) -> None:
        name = self._world.add(shape, _PLACE)
        if self._driver is not None and self._driver.items is not None:
            self._driver.items.choose(name)

    def _drag_item(self, client_id: int, name: str, place: Numbers, ends: bool) -> None:
        item = self._world.items.get(name)
        if item is None or not self._is_driver(client_id):
            return
        self._dragged_item = '' if ends else name
        self._change(moved(item, place, time.monotonic() - self._begin))

    def _change(self, item: Item) -> None:
        try:
            self._world.change(item)
        except ObstacleError as error:
            self._notice = str(error)

    def _click_item(self, client_id: int, name: str) -> None:
        if self._is_driver(client_id) and self._driver is not None and self._driver.items:
            self._driver.items.choose(name)

    def _compare(self, method: str) -> None:
        self._arms[self._driven].compare(method, time.monotonic())

    def _record(self, on: bool) -> None:
        if on:
            namespace = self._arms[self._driven].client.namespace
            self._recordings.begin(self._options.planner, namespace)
        else:
            self._recordings.end()

    def _show(self, links: bool, capsules: bool) -> None:
        for arm in self._arms:
            arm.show(links, capsules)

    def load(self, scene: PageScene) -> None:
        """Bring a scene: its arms, where they start, and what stands around them."""
        assert self._nodes is not None
        self._dead_man.stop(time.monotonic())
        self._notice, self._scene = '', scene
        is_new = self._nodes.load(scene.arms)
        self._world.load(scene.items)
        if is_new:
            self._listen_to(scene.arms)
            if self._driver is not None:
                client = self._driver.client
                client.gui.reset()
                client.scene.reset()
                self._make_driver(client)
        for arm in self._arms:
            arm.forget()
            arm.compare('', time.monotonic())

    def _listen_to(self, arms: Sequence[ArmSetup]) -> None:
        """Listen to the planners of some arms from now on."""
        for old in self._arms:
            old.remove()
            old.client.close()
        self._driven = 0
        self._arms = [ShownArm(
            self._server, PlannerClient(
                self._executor, f'/{name}' if (name := arm.namespace.strip('/')) else '',
                self._options.planner, drives=self._options.drives),
            None if self._nodes is None else self._nodes.folder_of(arm)) for arm in arms]
        if self._options.drives and self._sender is None:
            self._sender = ObstacleSender(self._executor)
        if self._sender is not None:
            self._sender.forget()


def _plain(text: str) -> str:
    return text.replace('&', '&amp;').replace('<', '&lt;')

"""The front panel in a browser: keyboard, width, token; and of racks, by one process or several."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

import pytest
from axe_playwright_python.sync_playwright import Axe
from daemon_process import Daemon, invoke
from playwright.sync_api import (
    Browser,
    BrowserContext,
    Locator,
    Page,
    expect,
    sync_playwright,
)
from rack_process import line_of, next_event, ready, reload, serve, workers_of
from served_control import TIMEOUT_S, ServedControl

from axistwin.catalog import find_model
from axistwin.control.panel import HEADERS, read_page
from axistwin.kernel.time import NS_PER_S

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
TOKEN = "+/0123456789abcdef=?"
BOARD = "mn400:1"

RACK = (
    '[control]\naddress = "127.0.0.1:0"\n'
    + line_of("press", ["mac23:0", "mac34-1:5"])
    + line_of("saw", "msc-250")
    + line_of("board", "mn400")
)


class Rack(NamedTuple):
    """A rack that is served, with its lines in ``folder``."""

    folder: Path
    process: Daemon
    url: str

    def send(self, line: str, model: str, *texts: str, timeout_s: float = TIMEOUT_S) -> bool:
        """Whether all that a host says there is answered."""
        port, patience = str(self.folder / line), ("--timeout", str(timeout_s))
        return invoke("send", port, "--model", model, *patience, *texts).exit_code == 0


pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium (apt-get install chromium)"),
]


@pytest.fixture(scope="module")
def served() -> Iterator[ServedControl]:
    """Devices with one axis, with four, and with none."""
    with ServedControl("mac23:0 mac34-1:5", "msc-250:1", BOARD) as served:
        yield served


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """Of one test; at its end nothing may stand on the console but what the test removed."""
    context = browser.new_context()
    context.set_default_timeout(TIMEOUT_S * 1000)
    expect.set_options(timeout=TIMEOUT_S * 1000)
    complaints: list[str] = []
    context.on("console", lambda message: complaints.append(message.text))
    context.on("weberror", lambda error: complaints.append(str(error.error)))
    yield context
    context.close()
    # The browser notes each answer that is an error: those are what some tests are about.
    assert [each for each in complaints if not each.startswith("Failed to load resource")] == []


@pytest.fixture
def page(context: BrowserContext, served: ServedControl) -> Page:
    """The panel, with all devices."""
    page = context.new_page()
    page.goto(f"{served.server.url}/")
    return page


def show(page: Page, device: str) -> None:
    """Go to a device by its link."""
    page.get_by_role("link", name=device).click()
    expect(page.get_by_role("heading", level=1)).to_have_text(device)


def switch(page: Page, control: str) -> None:
    """Press a switch, and see that it is over."""
    button = page.locator(f"[data-control='{control}']")
    was_on = button.get_attribute("aria-checked") == "true"
    button.click()
    expect(button).to_have_attribute("aria-checked", str(not was_on).lower())


def test_all_devices_are_shown_with_what_they_do(page: Page, served: ServedControl) -> None:
    """One link each, with the state."""
    expect(page.locator(".card")).to_have_count(4)
    served.ask("POST", "devices/mac34-1:5/power", {"action": "off"})
    expect(page.get_by_role("link", name="mac34-1:5")).to_contain_text("power off")
    served.ask("POST", "devices/mac34-1:5/power", {"action": "on"})
    expect(page.get_by_role("link", name="mac34-1:5")).not_to_contain_text("power off")


def test_a_field_is_set_and_a_wrong_value_is_explained(page: Page, served: ServedControl) -> None:
    """The browser lets none through; what the daemon answers stands in the alert."""
    show(page, "mac23:0")
    page.get_by_label("Supply volts", exact=True).fill("18.5")
    page.get_by_role("button", name="Set Supply volts").click()
    expect(page.locator("#notice")).to_contain_text("18.5 V")
    assert served.get("devices/mac23:0/state")["values"]["supply_volts"] == 18.5
    served.ask("PUT", "devices/mac23:0/controls/supply_volts", {"value": 12.0})
    field = page.get_by_label("Supply volts", exact=True)
    expect(field).to_have_value("12")
    field.fill("5000")
    page.get_by_role("button", name="Set Supply volts").click()
    assert served.get("devices/mac23:0/state")["values"]["supply_volts"] == 12.0
    field.evaluate("field => field.form.noValidate = true")
    page.get_by_role("button", name="Set Supply volts").click()
    expect(page.get_by_role("alert")).to_contain_text("0..1000 V")


def test_one_of_many_is_read_and_set_by_its_number(page: Page, served: ServedControl) -> None:
    """A flag of an MSC."""
    show(page, "msc-250:1")
    form = page.get_by_role("region", name="Flags").locator("form")
    form.get_by_label("Number").fill("200")
    form.get_by_role("button", name="Set").click()
    expect(page.locator("#notice")).to_contain_text("200: set to on")
    assert served.get("devices/msc-250:1/controls/flags.200")["name"] == "flags.200"
    form.get_by_role("button", name="Read").click()
    expect(page.locator("#notice")).to_have_text("flags 200 is on")


def test_events_are_paused_and_filtered(page: Page, served: ServedControl) -> None:
    """What comes in the pause is shown after it."""
    show(page, "mac23:0")
    entries = page.locator(".log li")
    page.get_by_role("button", name="Pause").click()
    served.ask("POST", "devices/mac23:0/power", {"action": "cycle"})
    expect(page.locator("#state")).to_contain_text("starting up")
    expect(entries).to_have_count(0)
    page.get_by_role("button", name="Pause").click()
    expect(entries).not_to_have_count(0)
    page.get_by_label("Filter").fill("nothing is called so")
    expect(entries.first).to_be_hidden()


def show_traffic(page: Page, line: str) -> None:
    """Go to a line by its link."""
    page.get_by_role("region", name=f"Line of {line}").get_by_role("link", name="Traffic").click()
    expect(page.get_by_role("heading", level=1)).to_have_text(f"Line of {line}")


def is_whole(simulation: Any) -> bool:
    """Whether the last message has nothing missing."""
    return "incomplete" not in simulation.explain(simulation.messages[-1].content)


def say(served: ServedControl, line: str, *texts: str) -> None:
    """A host says ``texts`` on a line and hears the replies, in no time that matters."""
    device = next(each for each in served.rack.devices.values() if each.line == line)
    family = find_model(device.twin.model).family
    simulation: Any = device.server.simulation
    simulation.transcript.pause_ns = NS_PER_S  # a reply stays in one piece on a busy machine
    for text in texts:
        before = len(simulation.messages)
        simulation.send(family.compose(text, device.twin.address))
        while len(simulation.messages) < before + 2 or not is_whole(simulation):
            simulation.receive()


def test_a_pause_loses_no_message(page: Page, served: ServedControl) -> None:
    """What comes is counted, and shown when it is over."""
    show_traffic(page, "msc-250:1")
    page.get_by_role("region", name="Traffic").get_by_role("button", name="Pause").click()
    rows = page.locator(".traffic .message")
    before = rows.count()
    say(served, "msc-250:1", "RQSTAT")
    expect(page.locator("[data-counts]")).to_contain_text(re.compile("paused: [2-9] wait"))
    expect(rows).to_have_count(before)
    page.get_by_role("region", name="Traffic").get_by_role("button", name="Pause").click()
    expect(rows).not_to_have_count(before)
    expect(page.get_by_text(re.compile("[2-9] messages waited"))).to_have_count(1)


def test_of_many_messages_only_those_in_sight_are_elements(page: Page) -> None:
    """The last ones, until somebody goes elsewhere; the oldest of too many are gone."""
    show_traffic(page, "mac23:0")
    expect(page.locator("#connection")).to_have_text("live")
    page.evaluate(
        """async () => {
          const { Monitor } = await import("/panel/monitor.js");
          const monitor = new Monitor();
          document.querySelector("#main").replaceChildren(monitor.element);
          for (let batch = 0; batch < 30; batch++) {
            const messages = Array.from({ length: 200 }, (_, number) => ({
              time_ns: (batch * 200 + number) * 1e6, direction: "host", unit: null,
              hex: "06", text: `message ${batch * 200 + number}`,
            }));
            monitor.hear({ messages, dropped: 1 });
          }
        }"""
    )
    rows = page.locator(".traffic .message")
    expect(rows.last).to_contain_text("message 5999")
    assert rows.count() < 50
    expect(page.locator("[data-counts]")).to_have_text("5000 messages of 5000, 30 dropped")
    page.get_by_role("listbox").press("Home")
    expect(page.locator(".detail")).to_contain_text("message 1000")


def test_status_bits_are_shown_by_name(page: Page) -> None:
    """With the requirement behind each, and the queue."""
    show(page, BOARD)
    bit = page.get_by_role("region", name="Status").locator("[data-bit='3']")
    expect(bit).to_have_text("m2 plusMN4-CMD-S-01off")
    switch(page, "inputs.m2_plus")
    expect(bit).to_have_text("m2 plusMN4-CMD-S-01on")
    expect(page.locator("[data-reading='inputs_status']")).to_have_text("8h")
    expect(page.locator("[data-reading='queued']")).to_have_text("0 commands")
    switch(page, "inputs.m2_plus")


def test_a_field_follows_what_is_set_back_at_once(page: Page, served: ServedControl) -> None:
    """Though the value is what it was, whenever somebody looks."""
    show(page, "mac23:0")
    field = page.get_by_label("Temperature celsius", exact=True)
    expect(field).to_have_value("25")
    expect(page.locator("#connection")).to_have_text("live")
    field.evaluate("field => (field.value = '60')")  # as after a set that others undid
    served.ask("PUT", "devices/mac23:0/controls/temperature_celsius", {"value": 25})
    expect(field).to_have_value("25")


def tab_to(page: Page, wanted: Locator) -> None:
    """Press Tab until it has the focus."""
    for _ in range(100):
        page.keyboard.press("Tab")
        if wanted.evaluate("each => each === document.activeElement"):
            return
    pytest.fail(f"Tab does not reach {wanted}")


def test_the_keyboard_alone_works_a_device(page: Page) -> None:
    """To the device, its supply, its first switch, and a fault on the wire, added and removed."""
    expect(page.locator(".card")).to_have_count(4)
    tab_to(page, page.get_by_role("link", name="mac23:0"))
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_be_focused()
    for name in ("Power", "Reference"):
        wanted = page.get_by_role("switch", name=name, exact=True)
        tab_to(page, wanted)
        was_on = wanted.get_attribute("aria-checked") == "true"
        for is_on in (not was_on, was_on):
            page.keyboard.press("Space")
            expect(wanted).to_have_attribute("aria-checked", str(is_on).lower())
    form = page.get_by_role("form", name="Add a fault")
    tab_to(page, form.get_by_label("Kind"))
    page.keyboard.type("drop")
    tab_to(page, form.get_by_label("Times"))
    page.keyboard.type("2")
    page.keyboard.press("Enter")
    expect(page.locator("[data-fault]")).to_have_text("seen 0, acted 0")
    remove = page.get_by_role("button", name="Remove fault")
    page.keyboard.press("Shift+Tab")
    tab_to(page, remove)
    page.keyboard.press("Enter")
    expect(page.locator("[data-fault]")).to_have_count(0)


def test_the_keyboard_alone_searches_the_traffic(page: Page, served: ServedControl) -> None:
    """It is held still, searched, and walked through."""
    say(served, BOARD, "E")
    expect(page.locator(".card")).to_have_count(4)
    tab_to(page, page.get_by_role("link", name="Traffic").last)
    page.keyboard.press("Enter")
    expect(page.locator(".traffic .message").last).to_be_visible()
    traffic = page.get_by_role("region", name="Traffic")
    tab_to(page, traffic.get_by_role("button", name="Pause"))
    page.keyboard.press("Enter")
    expect(page.locator("[data-counts]")).to_contain_text("paused")
    tab_to(page, page.get_by_label("Search"))
    page.keyboard.type("readposition")
    page.keyboard.press("Enter")
    expect(page.locator(".detail")).to_contain_text("ReadPosition")
    tab_to(page, page.get_by_role("listbox"))
    expect(page.locator(".detail")).to_contain_text("from the host")
    page.keyboard.press("ArrowDown")
    expect(page.locator(".detail")).to_contain_text("ReadPosition: START")


@pytest.mark.parametrize("device", ["", "mac23:0", "msc-250:1", BOARD, f"line of {BOARD}"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_all_and_axe_finds_nothing(
    page: Page, served: ServedControl, device: str, scheme: Literal["light", "dark"]
) -> None:
    """At 390 pixels nothing is scrolled sideways; names, roles and contrast are right."""
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator(".card")).to_have_count(4)
    if device.startswith("line"):
        say(served, BOARD, "E")
        show_traffic(page, BOARD)
        page.locator(".traffic .message").last.click()
        expect(page.locator(".detail")).not_to_be_empty()
    elif device:
        show(page, device)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()


def test_nothing_is_loaded_from_elsewhere(page: Page, served: ServedControl) -> None:
    """All requests go to the daemon; its pages forbid all else."""
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    answer = page.reload()
    expect(page.locator(".card")).to_have_count(4)
    assert answer is not None
    assert answer.headers["content-security-policy"] == HEADERS["Content-Security-Policy"]
    assert len(asked) >= len(read_page()) - 3  # without itself, the licence, and the icon
    assert [url for url in asked if not url.startswith(served.server.url)] == []


def test_a_daemon_with_a_token_is_worked_with_it(context: BrowserContext) -> None:
    """The panel asks for it, for requests and events; a wrong one is asked for again."""
    with ServedControl("mac23:0", token=TOKEN) as served:
        page = context.new_page()
        page.goto(f"{served.server.url}/")
        for token in ("0123456789abcdef", TOKEN):
            page.get_by_label("Token").fill(token)
            page.get_by_role("button", name="Go on").click()
            wrong = page.get_by_text("is not the daemon's")
            expect(wrong).to_have_count(0 if token == TOKEN else 1)
        expect(page.locator("#connection")).to_have_text("live")
        show(page, "mac23:0")
        switch(page, "inputs.reset")
        context.close()


# -- of a rack, by one process or behind the front of several ------------------------------------


@pytest.fixture(scope="module", params=[1, 2], ids=["one_process", "two_workers"])
def rack(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Rack]:
    """A rack that a user has started."""
    folder = tmp_path_factory.mktemp("rack")
    with serve(folder, RACK, request.param) as process:
        yield Rack(folder, process, next(iter(ready(process, 4).values()))["control"])


@pytest.fixture
def rack_page(context: BrowserContext, rack: Rack) -> Page:
    """Its panel."""
    page = context.new_page()
    page.goto(f"{rack.url}/")
    expect(page.locator(".card")).to_have_count(4)
    return page


def test_a_limit_switch_stops_the_axis(rack_page: Page) -> None:
    """It is jogged from the panel, the charts follow, and at the switch it stands."""
    show(rack_page, "mn400:1@board")
    rates = rack_page.locator("[data-reading='step_rates']")
    switch(rack_page, "inputs.run_jog")
    switch(rack_page, "inputs.jog_m1_plus")
    expect(rates).not_to_have_text("0, 0, 0, 0")
    expect(rack_page.locator(".chart canvas")).to_have_count(2)
    switch(rack_page, "inputs.m1_plus")
    expect(rates).to_have_text("0, 0, 0, 0")
    expect(rack_page.locator("[data-reading='counters']")).not_to_have_text("0, 0, 0, 0")
    for control in ("inputs.m1_plus", "inputs.jog_m1_plus", "inputs.run_jog"):
        switch(rack_page, control)


def test_the_supply_is_cut_and_restored(rack_page: Page) -> None:
    """By the switch, and by the button that does both; the state tells it."""
    show(rack_page, "mac23:0@press")
    switch(rack_page, "power")
    expect(rack_page.locator("#state")).to_have_text("power off")
    switch(rack_page, "power")
    expect(rack_page.locator("#state")).not_to_have_text("power off")
    rack_page.get_by_role("button", name="Off and on").click()
    expect(rack_page.locator("#notice")).to_have_text("Power is on")


def test_a_fault_on_the_wire_is_added_counted_and_removed(rack_page: Page, rack: Rack) -> None:
    """Two replies are lost: the retries are counted, and stand in the events."""
    show(rack_page, "mac34-1:5@press")
    form = rack_page.get_by_role("form", name="Add a fault")
    form.get_by_label("Kind").select_option("drop")
    form.get_by_label("Direction").select_option("to_host")
    form.get_by_label("Times").fill("2")
    form.get_by_role("button", name="Add").click()
    done = rack_page.locator("[data-fault]")
    expect(done).to_have_text("seen 0, acted 0")
    for _ in range(2):
        assert not rack.send("press", "mac34-1", "position? -> module 5", timeout_s=0.2)
    assert rack.send("press", "mac34-1", "position? -> module 5")
    expect(done).to_contain_text("seen 2, acted 2, over; lost: 06 13")
    expect(rack_page.locator(".log")).to_contain_text("lost: 06 13")
    rack_page.get_by_role("button", name="Remove fault").click()
    expect(done).to_have_count(0)
    form.get_by_label("Kind").select_option("error_frame")
    form.get_by_role("button", name="Add").click()
    expect(rack_page.locator("#problem")).to_contain_text("not for a serial line")


def test_traffic_is_shown_filtered_and_searched(rack_page: Page, rack: Rack) -> None:
    """In hex and in words, by device; what was said before is there, too."""
    assert rack.send("board", "mn400", "E")
    show_traffic(rack_page, "board")
    rows = rack_page.locator(".traffic .message")
    expect(rows.filter(has_text="ReadPosition (board 1)")).to_have_count(1)
    assert rack.send("board", "mn400", "S", "?")
    expect(rows.filter(has_text="LimitStatus (board 1)")).to_have_count(1)
    expect(rows.filter(has_text="81 53 81 55").locator(".whose")).to_have_text("1")
    traffic = rack_page.get_by_role("region", name="Traffic")
    expect(traffic.get_by_role("status")).to_have_text("")
    rack_page.get_by_label("Direction").select_option("from the host")
    expect(rows.filter(has_text="START")).to_have_count(0)
    rack_page.get_by_label("Direction").select_option("both ways")
    for text in ("8153", "81 53", "limitstatus"):
        rack_page.get_by_label("Show only").fill(text)
        expect(rows.filter(has_text="LimitStatus (board 1)")).to_have_count(1)
        expect(rows.filter(has_text="ReadPosition")).to_have_count(0)
    rack_page.get_by_label("Show only").fill("")
    rack_page.get_by_label("Search").fill("readposition")
    rack_page.get_by_role("button", name="Previous").click()
    detail = rack_page.locator(".detail")
    expect(detail).to_contain_text("ReadPosition: START")
    rack_page.get_by_role("button", name="Previous").click()
    expect(detail).to_contain_text("from the host")
    expect(rack_page.locator("[aria-selected='true']")).to_have_count(1)
    rack_page.get_by_role("listbox").press("ArrowDown")
    expect(detail).to_contain_text("from a device")


def test_what_is_shown_follows_a_reload(rack_page: Page, rack: Rack) -> None:
    """A line that comes, one that goes, and the device that is shown, which begins anew."""
    device = rack_page.context.new_page()
    device.goto(f"{rack.url}/")
    show(device, "msc-250:1@saw")
    switch(device, "power")
    state = device.locator("#state")
    expect(state).to_have_text("power off")
    changed = RACK.replace('name = "saw"', 'name = "saw"\nseed = 1') + line_of("drill")
    assert reload(rack.process, rack.folder, changed)["added"] == ["saw", "drill"]
    expect(state).to_have_text("no program")
    expect(device.get_by_role("alert").filter(has_text="Not served")).to_have_count(0)
    switch(device, "power")
    expect(rack_page.get_by_role("heading", name="Line of drill")).to_have_count(1)
    expect(rack_page.get_by_role("link", name="msc-250:1@saw")).to_contain_text("power off")
    assert reload(rack.process, rack.folder, RACK)["added"] == ["saw"]
    expect(rack_page.get_by_role("heading", name="Line of drill")).to_have_count(0)


@pytest.mark.parametrize("rack", [2], indirect=True)
def test_a_worker_that_is_killed_and_begun_again_is_seen(rack_page: Page, rack: Rack) -> None:
    """On all pages its line has failed, with the reason; they go on with the new one."""
    pages = [rack_page, rack_page.context.new_page(), rack_page.context.new_page()]
    for page in pages[1:]:
        page.goto(f"{rack.url}/")
    show(pages[1], "mac23:0@press")
    show_traffic(pages[2], "press")
    workers_of(rack.process)[0].kill()
    assert next_event(rack.process, "line_failed")["line"] == "press"
    pages.append(rack_page.context.new_page())
    pages[3].goto(f"{rack.url}/#/line/press")  # of one that has failed before
    told = "Not served any more: worker 0 has ended (SIGKILL); SIGHUP begins it again"
    for page in pages:
        expect(page.get_by_role("alert").filter(has_text=told)).to_have_count(1)
    assert reload(rack.process, rack.folder, RACK)["added"] == ["press"]
    for page in pages:
        expect(page.get_by_role("alert").filter(has_text="Not served")).to_have_count(0)
    switch(pages[1], "power")
    expect(rack_page.get_by_role("link", name="mac23:0@press")).to_contain_text("power off")
    assert rack.send("press", "mac34-1", "position? -> module 5")
    for page in pages[2:]:
        expect(page.locator(".traffic .message")).not_to_have_count(0)

"""The udev rules name every model once, in the forms in which udev compares."""

import re

from master.devices.hid import drivers, dualsense, joystick, wheels

RULE = re.compile(
    r'KERNEL=="hidraw\*", (ATTRS\{idVendor\}=="[0-9a-f]{4}"(, ATTRS\{idProduct\}=="[0-9a-f]{4}")?'
    r'|KERNELS=="0005:[0-9A-F]{4}:([0-9A-F]{4}|\*)\.\*"), TAG\+="uaccess"'
)


def test_every_line_is_a_rule_udev_understands():
    lines = [
        line for line in drivers.format_rules().splitlines() if line and not line.startswith("#")
    ]
    assert len(lines) == 2 * len(drivers.KNOWN_MODELS)
    assert len(set(lines)) == len(lines)
    for line in lines:
        assert RULE.fullmatch(line), line


def test_there_is_a_rule_for_every_model_that_a_driver_is_for():
    text = drivers.format_rules()
    models = [(wheels.LOGITECH_VENDOR, product) for product in wheels.LOGITECH_PRODUCTS]
    models += [
        (joystick.SPACEMOUSE_OLD_VENDOR, product) for product in joystick.SPACEMOUSE_OLD_PRODUCTS
    ]
    models += [(dualsense.VENDOR, product) for product in dualsense.PRODUCTS]
    for vendor, product in (*models, (wheels.FFBEAST_VENDOR, wheels.FFBEAST_PRODUCT)):
        assert f'{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}"' in text


def test_a_product_of_number_zero_is_one_model():
    text = drivers.format_rules()
    assert text.count('{idVendor}=="346e"') == text.count('{idVendor}=="346e", ATTRS{idProduct}')


def test_one_more_device_is_added_and_a_known_one_is_not_said_twice():
    text = drivers.format_rules([(0x1234, 0xABCD, "Mine\nRUN+=evil"), (0x1209, 0xFFB0, "again")])
    assert 'ATTRS{idVendor}=="1234", ATTRS{idProduct}=="abcd"' in text
    assert "# Mine RUN+=evil\n" in text
    assert text.count('"ffb0"') == 1
    assert not any(line.startswith("RUN") for line in text.splitlines())

#include "controller.h"

#include <string.h>

namespace teleop_rig {

void Controller::receive(uint8_t byte) {
  if (byte != 0) {
    if (filled_ < kLargest) {
      received_[filled_++] = byte;
    } else {
      too_long_ = true;
    }
    return;
  }
  uint8_t payload[kLargest];
  Frame frame;
  const size_t length = filled_;
  const bool damaged = too_long_;
  filled_ = 0;
  too_long_ = false;
  if (length == 0) return;
  if (damaged || !decode(received_, length, payload, &frame)) {
    ++bad_frames_;
    return;
  }
  take(frame);
}

void Controller::take(const Frame& frame) {
  if (frame.kind == kSet) {
    take_targets(frame);
  } else if (frame.kind == kStop) {
    switch_off(kStopped);
  } else if (frame.kind == kHello && frame.length == 2) {
    switch_off(0);  // whoever greets has just begun
    const uint16_t wanted = get16(frame.body);
    watchdog_ms_ = wanted < 5 ? 5 : wanted > 50 ? 50 : wanted;
    uint8_t body[6 + 32];
    put16(body, watchdog_ms_);
    put16(body + 2, board_.rate_hz());
    body[4] = board_.motors();
    body[5] = board_.cells();
    const size_t name = strnlen(board_.name(), 32);
    memcpy(body + 6, board_.name(), name);
    send(kInfo, board_.micros(), body, 6 + name);
  }
}

void Controller::take_targets(const Frame& frame) {
  if (frame.length < 2) return;
  const bool enable = (frame.body[0] & kEnabled) != 0;
  const uint8_t count = frame.body[1];
  if (count != board_.motors() || frame.length != 2u + 4u * count) return;
  answered_ = frame.sequence;
  target_us_ = board_.micros();
  if (!enable) {
    switch_off(0);
    flags_ &= static_cast<uint8_t>(~(kWatchdog | kStopped));  // acknowledged
    return;
  }
  if ((flags_ & (kWatchdog | kStopped)) != 0 || board_.motor_fault()) return;
  for (uint8_t i = 0; i < count; ++i) {
    const int32_t target = static_cast<int32_t>(get32(frame.body + 2 + 4 * i));
    const bool used = target != kMissing;
    if (used != on_[i]) {
      board_.enable(i, used);
      on_[i] = used;
    }
    if (used) board_.move_to(i, target);
  }
  flags_ |= kEnabled;
}

void Controller::check_watchdog() {
  if ((flags_ & kEnabled) == 0) return;
  if (board_.motor_fault()) {
    switch_off(0);
  } else if (board_.micros() - target_us_ > 1000u * watchdog_ms_) {
    switch_off(kWatchdog);
  }
}

void Controller::switch_off(uint8_t reason) {
  for (uint8_t i = 0; i < board_.motors(); ++i) {
    if (on_[i]) board_.enable(i, false);
    on_[i] = false;
  }
  flags_ = static_cast<uint8_t>((flags_ & ~kEnabled) | reason);
}

void Controller::sample(uint32_t sampled_us) {
  uint8_t body[7 + 4 * (kMostMotors + kMostCells)];
  const uint8_t motors = board_.motors(), cells = board_.cells();
  uint8_t flags = flags_;
  if (board_.motor_fault()) flags |= kMotorFault;
  if (board_.cell_fault()) flags |= kCellFault;
  body[0] = flags;
  put16(body + 1, bad_frames_);
  put16(body + 3, answered_);
  body[5] = motors;
  body[6] = cells;
  uint8_t* at = body + 7;
  for (uint8_t i = 0; i < motors; ++i, at += 4) {
    put32(at, static_cast<uint32_t>(board_.position(i)));
  }
  for (uint8_t i = 0; i < cells; ++i, at += 4) {
    put32(at, static_cast<uint32_t>(board_.cell(i)));
  }
  send(kState, sampled_us, body, static_cast<size_t>(at - body));
}

void Controller::send(uint8_t kind, uint32_t time_us, const uint8_t* body, size_t length) {
  uint8_t out[kLargest];
  const size_t whole = encode(Frame{kind, sequence_++, time_us, body, length}, out);
  board_.send(out, whole);
}

}  // namespace teleop_rig

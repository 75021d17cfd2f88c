// The firmware's protocol code on a computer: a board whose motors and cells a test provides.
#include <string.h>

#include <string>

#include "../teleop_rig/controller.h"

using namespace teleop_rig;

namespace {

class HostBoard : public Board {
 public:
  HostBoard(uint8_t motors, uint8_t cells) : motors_(motors), cells_(cells) {}
  const char* name() const override { return "host stub"; }
  uint8_t motors() const override { return motors_; }
  uint8_t cells() const override { return cells_; }
  uint16_t rate_hz() const override { return 1000; }
  uint32_t micros() override { return now_us; }
  int32_t position(uint8_t motor) override { return positions[motor]; }
  int32_t cell(uint8_t cell) override { return readings[cell]; }
  void enable(uint8_t motor, bool on) override { enabled[motor] = on; }
  void move_to(uint8_t motor, int32_t target) override { targets[motor] = target; }
  bool motor_fault() override { return fault; }
  bool cell_fault() override { return false; }
  void send(const uint8_t* data, size_t length) override {
    sent.append(reinterpret_cast<const char*>(data), length);
  }

  uint32_t now_us = 0;
  bool fault = false;
  int32_t positions[kMostMotors] = {}, readings[kMostCells] = {}, targets[kMostMotors] = {};
  bool enabled[kMostMotors] = {};
  std::string sent;

 private:
  uint8_t motors_, cells_;
};

struct Host {
  Host(uint8_t motors, uint8_t cells) : board(motors, cells), controller(board) {}
  HostBoard board;
  Controller controller;
};

}  // namespace

extern "C" {

void* host_open(uint8_t motors, uint8_t cells) { return new Host(motors, cells); }

void host_close(void* host) { delete static_cast<Host*>(host); }

void host_receive(void* host, uint32_t now_us, const uint8_t* data, size_t length) {
  static_cast<Host*>(host)->board.now_us = now_us;
  for (size_t i = 0; i < length; ++i) static_cast<Host*>(host)->controller.receive(data[i]);
}

// One pass of the sketch's loop at `now_us`; with `sampled` the converter has finished, at
// `sampled_us`, which may be of another clock than the watchdog's.
void host_step(void* host, uint32_t now_us, uint32_t sampled_us, bool sampled, bool fault,
               const int32_t* positions, const int32_t* cells) {
  Host& h = *static_cast<Host*>(host);
  h.board.now_us = now_us;
  h.board.fault = fault;
  memcpy(h.board.positions, positions, 4u * h.board.motors());
  memcpy(h.board.readings, cells, 4u * h.board.cells());
  h.controller.check_watchdog();
  if (sampled) h.controller.sample(sampled_us);
}

// Targets and whether each motor is enabled; returns the flags.
uint8_t host_motors(void* host, int32_t* targets, uint8_t* enabled) {
  Host& h = *static_cast<Host*>(host);
  memcpy(targets, h.board.targets, 4u * h.board.motors());
  for (uint8_t i = 0; i < h.board.motors(); ++i) enabled[i] = h.board.enabled[i];
  return h.controller.flags();
}

// Takes the bytes that were sent, at most `room`.
size_t host_sent(void* host, uint8_t* out, size_t room) {
  std::string& sent = static_cast<Host*>(host)->board.sent;
  const size_t count = sent.size() < room ? sent.size() : room;
  memcpy(out, sent.data(), count);
  sent.erase(0, count);
  return count;
}

}

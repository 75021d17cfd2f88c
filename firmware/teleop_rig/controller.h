// What the firmware does with frames: targets, watchdog, emergency stop. No hardware in here.
#pragma once
#include "frames.h"

namespace teleop_rig {

constexpr uint8_t kMostMotors = 16;
constexpr uint8_t kMostCells = 16;
constexpr uint16_t kWatchdogMs = 40;  // until a HELLO asks for another

// What a board provides.
class Board {
 public:
  virtual ~Board() = default;
  virtual const char* name() const = 0;
  virtual uint8_t motors() const = 0;
  virtual uint8_t cells() const = 0;
  virtual uint16_t rate_hz() const = 0;  // at which the sketch calls Controller::sample
  virtual uint32_t micros() = 0;
  virtual int32_t position(uint8_t motor) = 0;  // [counts]
  virtual int32_t cell(uint8_t cell) = 0;       // [counts] of the newest conversion, or kMissing
  virtual void enable(uint8_t motor, bool on) = 0;  // off: without power, braked if there is a brake
  virtual void move_to(uint8_t motor, int32_t target) = 0;  // [counts]; only while enabled
  virtual bool motor_fault() = 0;
  virtual bool cell_fault() = 0;
  virtual void send(const uint8_t* data, size_t length) = 0;
};

class Controller {
 public:
  explicit Controller(Board& board) : board_(board) {}

  // One received byte.
  void receive(uint8_t byte);
  // Call as often as possible: stops the motors if no target came for too long.
  void check_watchdog();
  // Call once a sample, when the converter has finished: sends a STATE.
  void sample(uint32_t sampled_us);

  uint8_t flags() const { return flags_; }

 private:
  void take(const Frame& frame);
  void take_targets(const Frame& frame);
  void switch_off(uint8_t reason);
  void send(uint8_t kind, uint32_t time_us, const uint8_t* body, size_t length);

  Board& board_;
  uint8_t received_[kLargest];
  size_t filled_ = 0;
  bool too_long_ = false;
  uint16_t sequence_ = 0, answered_ = 0, bad_frames_ = 0;
  uint16_t watchdog_ms_ = kWatchdogMs;
  uint32_t target_us_ = 0;  // when the newest target came
  // after a restart encoders count anew: a SET that disables must come before one that moves
  uint8_t flags_ = kStopped;
  bool on_[kMostMotors] = {};
};

}  // namespace teleop_rig

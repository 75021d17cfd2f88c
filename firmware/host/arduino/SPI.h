// SPI of the Teensy's core, to the model of the converter in sketch.cpp.
#pragma once
#include <stdint.h>

constexpr uint8_t SPI_MODE1 = 4;

struct SPISettings {
  SPISettings(uint32_t hertz, uint8_t order, uint8_t mode) : hertz(hertz), order(order), mode(mode) {}
  uint32_t hertz;
  uint8_t order, mode;
};

struct SpiBus {
  void begin() { begun = true; }
  void beginTransaction(const SPISettings& settings);
  uint8_t transfer(uint8_t out);
  void endTransaction();

  bool begun = false, busy = false;
};
extern SpiBus SPI;

// Resistive matrix (Velostat between strips of copper, or an FSR matrix) for palpate: scans it and sends frames for ever.
// Not tried on a board. Wiring and frame: README.md of this plug-in.
//
// Rows are driven by digital pins, one high and all others low: low ones load the column, which the host takes back.
// Columns come through two CD74HC4067 a matrix, all with common address lines: columns 0 to 15 of matrix 0 to A0, 16 and
// more to A1, those of matrix 1 to A2 and A3, and so on; each CD74HC4067 has one resistor to ground.

const uint8_t MATRICES = 3;  // at most 3 on six analog pins; all have the same rows, in common, and as many columns
const uint8_t ROWS = 8;   // at most 8; as in the rig file
const uint8_t COLS = 20;  // at most 32
const uint32_t PERIOD_US = 33333;
const uint8_t ROW_PINS[8] = {2, 3, 4, 5, 6, 7, 8, 9};
const uint8_t ADDRESS_PINS[4] = {10, 11, 12, 13};
const uint8_t SETTLE_US = 10;

const uint8_t ANALOG_PINS[6] = {A0, A1, A2, A3, A4, A5};

uint16_t cells[ROWS][COLS];
uint16_t number = 0;
uint32_t due;

uint16_t crc16(uint16_t crc, uint8_t byte) {  // CCITT, 0x1021
  crc ^= (uint16_t)byte << 8;
  for (uint8_t k = 0; k < 8; k++) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  return crc;
}

uint16_t sum;

void send(uint8_t byte) {
  sum = crc16(sum, byte);
  Serial.write(byte);
}

void send16(uint16_t value) {
  send(value & 0xFF);
  send(value >> 8);
}

void setup() {
  Serial.begin(1000000);
  for (uint8_t k = 0; k < ROWS; k++) pinMode(ROW_PINS[k], OUTPUT);
  for (uint8_t k = 0; k < 4; k++) pinMode(ADDRESS_PINS[k], OUTPUT);
  ADCSRA = (ADCSRA & ~7) | 4;  // ADC clock of 1 MHz on a 16 MHz board: 13 µs a conversion, 10 bits but for the last
  due = micros();
}

void scan(uint8_t matrix) {
  for (uint8_t col = 0; col < COLS; col++) {
    for (uint8_t k = 0; k < 4; k++) digitalWrite(ADDRESS_PINS[k], col >> k & 1);
    for (uint8_t row = 0; row < ROWS; row++) {
      digitalWrite(ROW_PINS[row], HIGH);
      delayMicroseconds(SETTLE_US);
      cells[row][col] = analogRead(ANALOG_PINS[2 * matrix + (col >= 16)]);
      digitalWrite(ROW_PINS[row], LOW);
    }
  }
}

void send_frame(uint8_t matrix) {
  uint32_t now = micros();
  sum = 0xFFFF;
  send(0xA5);
  send(0xC3);
  send(ROWS);
  send(COLS);
  send(matrix);
  send16(number);
  send16(now & 0xFFFF);
  send16(now >> 16);
  for (uint8_t row = 0; row < ROWS; row++)
    for (uint8_t col = 0; col < COLS; col++) send16(cells[row][col]);
  uint16_t crc = sum;
  Serial.write(crc & 0xFF);
  Serial.write(crc >> 8);
}

void loop() {
  while ((int32_t)(micros() - due) < 0) {}
  due += PERIOD_US;
  for (uint8_t matrix = 0; matrix < MATRICES; matrix++) {
    scan(matrix);
    send_frame(matrix);
  }
  number++;
}

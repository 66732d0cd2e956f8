// Numbers that an operator types in and sends: one that the console refuses goes back to the last
// one that it took.

import { byId, connection, tell } from "./shell.js";

export class TypedNumbers {
  // `fields` are by the key of the command `what`: the field's id, and its name in a sentence.
  constructor(what, fields) {
    this.fields = Object.entries(fields).map(([key, [id, name]]) => ({ key, input: byId(id), name }));
    this.sent = Object.fromEntries(this.fields.map(({ key, input }) => [key, input.value]));
    this.before = this.sent;
    connection.addEventListener("refused", ({ detail }) => {
      if (detail.do === what && detail.key in this.sent) this.setBack(detail.key);
    });
  }

  // The numbers by key, null where nothing is typed; nothing at all, and a word, if one is none.
  read() {
    const wrong = this.fields.find(({ input }) => input.validity.badInput);
    if (wrong) {
      tell(`The ${wrong.name} must be a number.`);
      wrong.input.value = this.sent[wrong.key];
      return null;
    }
    this.before = this.sent;
    this.sent = Object.fromEntries(this.fields.map(({ key, input }) => [key, input.value]));
    return Object.fromEntries(this.fields.map(({ key, input }) => [key, input.value === "" ? null : input.valueAsNumber]));
  }

  setBack(key) {
    this.sent = { ...this.sent, [key]: this.before[key] };
    this.fields.find((field) => field.key === key).input.value = this.before[key];
  }
}
